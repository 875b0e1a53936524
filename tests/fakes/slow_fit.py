"""A fit of `Bowl` that tests run in a process of its own and kill: ``python -m fakes.slow_fit FIT start``."""

import sys
import time

from fakes.bowl import Bowl
from sysid.fit import checkpoint, search

IDENTITY = {"campaign_file": "ab" * 32, "population": 40, "log drop-1": "cd" * 32}
SETTINGS = search.SearchSettings(40, 3, 5, 14, "ga", "cmaes")


class Paced(Bowl):
    """Slow enough that a kill hits every part of a fit, writing included."""

    def evaluate(self, cube):
        time.sleep(5e-5 * len(cube))
        return super().evaluate(cube)


def work(fit, resume):
    checkpoint.INTERVAL = 0.0
    hold = checkpoint.Checkpoint(fit, IDENTITY, resume=resume)
    print("begun", flush=True)
    search.run_many(Paced(), SETTINGS, checkpoint=hold)


if __name__ == "__main__":
    work(sys.argv[1], sys.argv[2] == "resume")
