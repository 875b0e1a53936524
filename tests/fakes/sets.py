"""Parameter sets made by hand, and how sets of one optimum are compared."""

import numpy as np

from sysid.fit.optima import SAME_NRMSE
from sysid.parameter_sets import ParameterRecord, ParameterSets
from sysid.parameters import common_name


def assert_sets_agree(result):
    """Sets of the best optimum agree within 1 % in every parameter that no finding doubts; return these."""
    doubts = {
        name
        for finding in result.provenance["findings"]
        if finding["code"] in ("not-identifiable", "weakly-identifiable")
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


def made_sets(**changes):
    """Three sets of four parameters, the last at a bound, on a fitted and a held-out drop."""
    parameters = (
        ParameterRecord(
            "leg_axial_stiffness", "k_h", "N/m", "free", "Stiffness.", "guess", 6440.0, 2e3, 12e3, "log",
            (5600.0, 6600.0),
        ),
        ParameterRecord("body_mass", "m_B", "kg", "measured", "Mass.", "scale", 1.242, 0.1, 10.0, "log"),
        ParameterRecord("saturation_current", "I_sat", "A", "fixed", "Limit.", "", 0.35, 0.05, 9.0, "log"),
        ParameterRecord("leg_length", "l", "m", "derived", "At rest.", "computed"),
    )  # fmt: skip
    fields = {
        "kind": "gear",
        "name": "six-drops",
        "parameters": parameters,
        "values": [
            [6400.1, 1.242, np.inf, 0.13],
            [6500.3, 1.242, np.inf, 0.129],
            [2000.1, 1.242, np.inf, 0.1],
        ],
        "nrmse": [0.083, 0.1, 0.121],
        "runs": (3, 1, 2),
        "seeds": (33, 11, 22),
        "at_bound": [[0, 0, 0, 0], [0, 0, 0, 0], [-1, 0, 0, 0]],
        "trials": ("drop-1", "drop-2"),
        "uses": ("fit", "validate"),
        "channels": ("x_B", "z_B"),
        "channel_units": ("m", "m"),
        "channel_weights": (1.0, 1.0),
        "nrmse_by_trial": np.arange(12.0).reshape(3, 2, 2) / 7,
        "settings": {"surface_law": "lf", "gravity": 9.81, "filter": {"kind": "kaiser", "taps": 75}},
        "provenance": {"logs": {"drop-1.csv": "00ff"}, "nrmse_denominator": "std"},
        "warnings": ("1 of 3 sets ends at the lower bound of leg_axial_stiffness.",),
    }
    return ParameterSets(**(fields | changes))
