"""The golden record: what the code computed when it was written, and how that is compared.

    python tests/golden/record.py SUBJECT ...      write these subjects anew; ``all`` is every one

A record is rewritten only by the name of its subject. The message of the commit that changes one names the
reason for every subject that changed; a restructuring has none.
"""

import json
import sys
import time
from pathlib import Path

import sysid  # noqa: F401  one thread of BLAS, as in `tests/conftest.py`

# isort: split
import subjects

VALUES = Path(__file__).resolve().parent / "values"

# On another processor or with other libraries: relative tolerance, and share of the numbers that may miss it.
LEVELS = {
    # Names, counts, words, and arrays made by single roundings: equal everywhere.
    "always": (0.0, 0.0),
    # Costs of a motor: smooth, so rounding stays rounding; without AVX 1e-10 at most.
    "benches": (1e-6, 0.0),
    # Costs of drops: the simulation's steps adapt to rounding, and impacts magnify their errors. Without AVX
    # a tenth of the rows moves by more than 3e-5, none of low friction by 4e-4, one of high friction by 5e-3.
    "drops": (1e-3, 0.03),
    # Loaded arrays made by sums of products, which some processors fuse: some units in the last place.
    "loaded": (1e-12, 0.0),
    # Landing maps: as drops, and a cell beside the edge of a class may fall on its other side. Without AVX
    # four of 672 numbers move by more.
    "cells": (1e-6, 0.05),
    # A search breeds other candidates once two costs change their order: near in NRMSE, not in values.
    "best": (0.05, 0.0),
    # Equal bits are promised on equal processors only.
    "here": None,
}


def same(recorded, now, exact):
    """Return where two subjects' values differ: one line each, none when they are the same.

    Parameters
    ----------
    recorded, now : dict
        Values by level, JSON-able.
    exact : bool
        Compare every bit; otherwise as `LEVELS` says.
    """
    now = json.loads(json.dumps(now))
    if recorded.keys() != now.keys():
        return [f"levels {[*now]}, recorded {[*recorded]}"]
    out = []
    for level in recorded:
        rule = (0.0, 0.0) if exact else LEVELS[level]
        if rule is not None:
            checked = list(_leaves(recorded[level], now[level], rule[0], level))
            wrong = [line for line in checked if line is not None]
            out += wrong if len(wrong) > rule[1] * len(checked) else []
    return out


def _leaves(then, now, rtol, place):
    """Yield None for every equal leaf, a sentence for every other one."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key in {**then, **now}:
            if key in then and key in now:
                yield from _leaves(then[key], now[key], rtol, f"{place}/{key}")
            else:
                yield f"{place}/{key} is {'not recorded' if key in now else 'gone'}"
    elif isinstance(then, list) and isinstance(now, list) and all(str(key)[:1] == "/" for key in then + now):
        yield from (None if key in now else f"{place}: {key} is gone" for key in then)
        yield from (f"{place}: {key} is not recorded" for key in now if key not in then)
        yield None if len(then) == len(now) else f"{place}: {len(now)} entries, recorded {len(then)}"
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for i, (a, b) in enumerate(zip(then, now, strict=True)):
            yield from _leaves(a, b, rtol, f"{place}[{i}]")
    else:
        equal = type(then) is type(now) and (then == now or (then != then and now != now))
        yield None if equal or (rtol and _near(then, now, rtol)) else f"{place}: {now!r}, recorded {then!r}"


def _near(then, now, rtol):
    try:
        a, b = (float.fromhex(one) if isinstance(one, str) else float(one) for one in (then, now))
    except (TypeError, ValueError):
        return False
    return (a != a and b != b) or a == b or abs(a - b) <= rtol * max(abs(a), abs(b))


def read(name):
    """Return a subject's values and the machine on which they were recorded."""
    document = json.loads((VALUES / f"{name}.json").read_text(encoding="utf-8"))
    return document["values"], document["machine"]


def write(name):
    """Record a subject anew."""
    document = {"machine": subjects.machine(), "values": subjects.SUBJECTS[name]()}
    VALUES.mkdir(exist_ok=True)
    text = json.dumps(document, indent=1, ensure_ascii=False)
    (VALUES / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def main(names):
    """Write the named subjects, each with what has changed in it."""
    unknown = [name for name in names if name not in (*subjects.SUBJECTS, "all")]
    if unknown or not names:
        sys.exit(f"name the subjects to record anew: all, {', '.join(subjects.SUBJECTS)}")
    for name in subjects.SUBJECTS if "all" in names else names:
        before = read(name)[0] if (VALUES / f"{name}.json").is_file() else None
        began = time.process_time()
        write(name)
        changed = "new" if before is None else f"{len(same(before, read(name)[0], True))} values differ"
        print(f"{name}: {changed}, {time.process_time() - began:.1f} s of processor time")


if __name__ == "__main__":
    main(sys.argv[1:])
