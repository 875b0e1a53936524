"""The paper's Tables I and II as ready parameter sets.

``python tests/fakes/published.py FOLDER`` writes them as JSON; the result is `data_samples/published/`.
Each file has one set: the printed mean, with the printed σ as the parameter's `stated_sigma`. Bounds, seeds
and the single sets of the five runs are not printed, so they are absent here. What the paper does not print
but a simulator needs says so in its `source`.

References
----------
J. Bass, A. Lussier Desbiens, "Improving Multirotor Landing Performance on Inclined Surfaces Using Reverse
Thrust", IEEE Robotics and Automation Letters, Tables I and II.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from sysid.export import export
from sysid.gear import model as gear
from sysid.motor import model as motor
from sysid.parameter_sets import ParameterRecord, ParameterSets, Status
from sysid.parameters import ParameterTable

_PAPER = (
    "J. Bass, A. Lussier Desbiens, Improving Multirotor Landing Performance on Inclined Surfaces Using "
    "Reverse Thrust, IEEE Robotics and Automation Letters"
)
_CURVE = "not printed in the paper: a curve of the right size for a 9 x 4.5 inch propeller"
_KV = (
    "Table I prints 0.099, which cannot be meant: 960 rpm/V is 100.5 rad/s/V, whose inverse is 0.00995, and "
    "only that gives the ~100 ms response that the paper reports (0.099 gives 0.8 ms)"
)


_UNPRINTED = "not printed in the paper"
_GA = "Table I, genetic algorithm"
_BY_HAND = "Table I, adjusted by hand"
_MEASURED = "Table II, measured"

Printed = tuple[float, Status, str]
"""Value [SI], how the paper obtained it, and where it is printed."""

TABLE_1: dict[str, Printed] = {
    "winding_resistance": (0.299, "free", _GA),
    "winding_inductance": (0.0038, "free", f"{_GA}; printed in kg, meant in henry"),
    "viscous_damping": (9.2e-9, "free", f"{_GA}; hardly moves the cost"),
    "back_emf_constant": (0.00995, "fixed", _KV),
    "torque_constant": (0.00995, "fixed", _KV),
    "rotor_inertia": (2.7e-5, "measured", "Table I, measured"),
    "saturation_current": (0.35, "fixed", _BY_HAND),
    "saturation_speed": (6.3, "fixed", _BY_HAND),
    "reference_voltage": (11.1, "fixed", f"{_UNPRINTED}: three lithium-polymer cells"),
    **{
        name: (motor.PARAMETERS.nominal[name], "fixed", _CURVE)
        for name in motor.PARAMETERS.group("no-load line", "thrust curve", "torque curve")
    },
}

TABLE_2: dict[str, Printed] = {
    "body_mass": (1.242, "measured", _MEASURED),
    "body_inertia": (0.0137, "measured", _MEASURED),
    "foot_dx": (0.105, "measured", _MEASURED),
    "foot_dz": (0.151, "measured", _MEASURED),
    "gravity": (9.81, "fixed", "standard value"),
    "thrust_point_dx": (
        0.225 * math.cos(math.pi / 4), "fixed", f"{_UNPRINTED}: F450 in X configuration, arms of 0.225 m",
    ),
    "leg_mass_fraction": (0.5, "fixed", f"{_UNPRINTED}: the middle of the leg"),
    "slip_regularization": (0.01, "fixed", f"{_UNPRINTED}: a slip speed small against the fitted ones"),
}  # fmt: skip
# Parameters that the low-friction column does not fit.
TABLE_2_LF: dict[str, Printed] = {
    "leg_mass": (0.02, "measured", _MEASURED),
    "leg_inertia": (2.0e-4, "measured", "Table II, calculated"),
    "kinetic_friction": (0.44, "measured", f"{_MEASURED} on UHMW PE"),
    "static_friction_excess": (0.0, "fixed", "Table II: N/A; the low-friction law has none"),
}
# Mean and σ over the five runs, on low and on high friction [SI].
FITTED: dict[str, tuple[tuple[float, float] | None, tuple[float, float]]] = {
    "joint_dx": ((0.088, 0.005), (0.067, 0.001)),
    "joint_dz": ((0.024, 0.008), (0.019, 0.007)),
    "leg_axial_stiffness": ((6440.0, 599.0), (6670.0, 350.0)),
    "leg_axial_damping": ((14.3, 4.6), (20.3, 1.3)),
    "leg_bending_stiffness": ((10.5, 0.3), (3.44, 0.4)),
    "leg_bending_damping": ((0.056, 0.045), (0.017, 0.005)),
    "ground_stiffness": ((1.10e5, 0.07e5), (1.49e5, 0.1e5)),
    "ground_damping": ((0.042, 0.01), (0.058, 0.036)),
    "leg_mass": (None, (0.015, 0.004)),
    "leg_inertia": (None, (2.1e-4, 1.7e-4)),
    "kinetic_friction": (None, (0.87, 0.11)),
    "static_friction_excess": (None, (0.08, 0.07)),
}
# "Measured" column of fitted rows [SI], which the paper obtained for validation only (footnote c).
RANGES: dict[str, tuple[float, float]] = {
    "leg_axial_stiffness": (5600.0, 6600.0),
    "leg_axial_damping": (3.6, 8.9),
    "leg_bending_stiffness": (14.0, 16.0),
    "leg_bending_damping": (0.009, 0.037),
    "ground_stiffness": (0.4e5, 2.5e5),
    "leg_mass": (0.02, 0.02),
    "leg_inertia": (2.0e-4, 2.0e-4),
}


def _sets(
    name: str,
    table: ParameterTable,
    printed: Mapping[str, Printed],
    nrmse: float,
    channels: Mapping[str, str],
    sigma: Mapping[str, float] | None = None,
    *,
    kind: str,
    settings: Mapping[str, str],
    provenance: Mapping[str, object],
    warnings: tuple[str, ...],
) -> ParameterSets:
    """Return one set; what the model has beyond the paper's tables (instruments) takes its default."""
    if unknown := set(printed) - set(table):
        raise ValueError(f"{name}: the model's table has no {', '.join(sorted(unknown))}")
    values, records = [], []
    for row in table.values():
        value, status, source = printed.get(row.name, (row.nominal, "fixed", f"{_UNPRINTED}: {row.source}"))
        values.append(value)
        stated = (sigma or {}).get(row.name)
        measured = RANGES.get(row.name) if stated is not None else None
        records.append(
            ParameterRecord(
                row.name, row.symbol, row.unit, status, row.meaning, source,
                measured_range=measured, stated_sigma=stated, group=row.group,
            )
        )  # fmt: skip
    return ParameterSets(
        kind=kind,
        name=name,
        parameters=tuple(records),
        values=np.array([values]),
        nrmse=np.array([nrmse]),
        runs=(0,),
        seeds=(0,),
        at_bound=np.zeros((1, len(table)), dtype=np.int8),
        trials=(),
        uses=(),
        channels=tuple(channels),
        channel_units=tuple(channels.values()),
        channel_weights=(1.0,) * len(channels),
        nrmse_by_trial=np.empty((1, 0, len(channels))),
        settings=settings,
        provenance=provenance,
        warnings=warnings,
    )


def table_1() -> ParameterSets:
    """Return Table I: DJI 2312, 960 rpm/V, with a 9 x 4.5 inch propeller."""
    return _sets(
        "published-motor",
        motor.PARAMETERS,
        TABLE_1,
        0.0267,
        {"torque": "N·m", "speed": "rad/s"},
        kind="motor",
        settings={
            "command": "u in [-1, 1]; the paper prints no pulse widths",
            "no_load_speed": "a u + b sign(u), per direction",
            "static_curves": "c2 Ω|Ω| + c1 Ω, per direction",
        },
        provenance={
            "paper": _PAPER,
            "values": "printed values of one genetic algorithm",
            "table": "I",
            "nrmse_denominator": "not printed",
        },
        warnings=(
            "k_v and k_t are 0.00995 from the rating of 960 rpm/V: the printed 0.099 cannot be meant.",
            "The static curves and the no-load speed are not printed in the paper.",
        ),
    )


def table_2(surface: Literal["lf", "hf"]) -> ParameterSets:
    """Return a column of Table II: the DJI F450's gear on UHMW PE ("lf") or roofing shingles ("hf")."""
    low = surface == "lf"
    source = f"Table II, {'low' if low else 'high'}-friction mean of five genetic algorithm runs"
    fitted = {name: cells[0 if low else 1] for name, cells in FITTED.items()}
    means: dict[str, Printed] = {name: (cell[0], "free", source) for name, cell in fitted.items() if cell}
    return _sets(
        f"published-gear-{surface}",
        gear.PARAMETERS,
        TABLE_2 | TABLE_2_LF | means,
        math.nan,
        {"x_B": "m", "z_B": "m", "x_B_rate": "m/s", "z_B_rate": "m/s", "q_B": "rad"},
        {name: cell[1] for name, cell in fitted.items() if cell},
        kind="gear",
        settings={
            "surface": surface,
            "frame": (
                "x down-slope, z up, y into the page; positive pitch turns z toward x; a slope falls "
                "toward +x; rear leg up-slope at -x, front leg at +x; every leg value is of the pair at "
                "that end"
            ),
        },
        provenance={
            "paper": _PAPER,
            "values": "printed mean over five runs",
            "table": "II",
            "nrmse_range": (0.083, 0.121) if low else (0.133, 0.138),
            "nrmse_denominator": "not printed",
        },
        warnings=(
            "The mean of five sets is no fitted set: the paper simulates with the five sets, which it does "
            "not print.",
        ),
    )


def write_published(folder: str | Path) -> tuple[Path, ...]:
    """Write the three sets as JSON into a folder, which is made; files of the same names are replaced."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    all_sets = (table_1(), table_2("lf"), table_2("hf"))
    return tuple(export(sets, folder / f"{sets.name}.json") for sets in all_sets)


if __name__ == "__main__":
    for file in write_published(sys.argv[1] if len(sys.argv) > 1 else "data_samples/published"):
        print(file)
