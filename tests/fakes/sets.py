"""How parameter sets of one optimum are compared."""

import numpy as np

from sysid.fit.optima import SAME_NRMSE
from sysid.parameters import common_name


def assert_sets_agree(result):
    """Sets of the best optimum agree within 1 % in every parameter that no finding doubts; return these."""
    doubts = {
        name
        for finding in result.provenance["findings"]
        if finding["code"] in ("not-identifiable", "weakly-determined")
        for name in finding["parameters"]
    }
    best = result.nrmse <= (1 + SAME_NRMSE) * result.nrmse[0]
    agreeing = {
        record.name: column
        for record, column in zip(result.parameters, result.values[best].T, strict=True)
        if record.status == "free" and common_name(record) not in doubts
    }
    for name, column in agreeing.items():
        assert np.ptp(column) <= 0.01 * abs(column.mean()), name
    return set(agreeing)
