"""How parameter sets of one optimum are compared."""

import numpy as np

from sysid.fit.optima import SAME_NRMSE
from sysid.parameters import in_words


def assert_sets_agree(result):
    """Sets of the best optimum agree within 1 % in every parameter that no warning doubts; return these."""
    doubts = " ".join(w for w in result.warnings if "not fixed by the data" in w or "held no tighter" in w)
    best = result.nrmse <= (1 + SAME_NRMSE) * result.nrmse[0]
    held = {
        record.name: column
        for record, column in zip(result.parameters, result.values[best].T, strict=True)
        if record.status == "free" and in_words(record) not in doubts
    }
    for name, column in held.items():
        assert np.ptp(column) <= 0.01 * abs(column.mean()), name
    return set(held)
