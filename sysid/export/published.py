"""The paper's Tables I and II as ready parameter sets.

``python -m sysid.export.published FOLDER`` writes them as JSON; `data_samples/published/` holds the result.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

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


@dataclass(frozen=True)
class Printed:
    """One printed (or, where `source` says so, not printed) number.

    Parameters
    ----------
    value : float
        [SI].
    status : {"free", "measured", "fixed", "derived"}
        How the paper obtained it.
    source : str
        Where it stands.
    sigma : float, optional
        Printed standard deviation over the five runs [SI].
    measured_range : (float, float), optional
        The "measured" column of Table II for a fitted number [SI].
    """

    value: float
    status: Status
    source: str
    sigma: float | None = None
    measured_range: tuple[float, float] | None = None


_UNPRINTED = "not printed in the paper"
_GA_1 = "Table I, genetic algorithm"
_BY_HAND = "Table I, adjusted by hand"

TABLE_1: dict[str, Printed] = {
    "winding_resistance": Printed(0.299, "free", _GA_1),
    "winding_inductance": Printed(0.0038, "free", f"{_GA_1}; printed in kg, meant in henry"),
    "viscous_damping": Printed(9.2e-9, "free", f"{_GA_1}; hardly moves the cost"),
    "back_emf_constant": Printed(0.00995, "fixed", _KV),
    "torque_constant": Printed(0.00995, "fixed", _KV),
    "rotor_inertia": Printed(2.7e-5, "measured", "Table I, measured"),
    "saturation_current": Printed(0.35, "fixed", _BY_HAND),
    "saturation_speed": Printed(6.3, "fixed", _BY_HAND),
    "reference_voltage": Printed(11.1, "fixed", "not printed in the paper: three lithium-polymer cells"),
    "no_load_slope_forward": Printed(1030.0, "fixed", _CURVE),
    "no_load_intercept_forward": Printed(0.0, "fixed", _CURVE),
    "no_load_slope_reverse": Printed(1030.0, "fixed", _CURVE),
    "no_load_intercept_reverse": Printed(0.0, "fixed", _CURVE),
    "thrust_quadratic_forward": Printed(1.2e-5, "fixed", _CURVE),
    "thrust_linear_forward": Printed(0.0, "fixed", _CURVE),
    "thrust_quadratic_reverse": Printed(0.62e-5, "fixed", _CURVE),
    "thrust_linear_reverse": Printed(0.0, "fixed", _CURVE),
    "torque_quadratic_forward": Printed(1.65e-7, "fixed", _CURVE),
    "torque_linear_forward": Printed(0.0, "fixed", _CURVE),
    "torque_quadratic_reverse": Printed(1.7e-7, "fixed", _CURVE),
    "torque_linear_reverse": Printed(0.0, "fixed", _CURVE),
}

_MEASURED = "Table II, measured"


def _fitted(
    column: Literal["low", "high"],
    value: float,
    sigma: float,
    measured_range: tuple[float, float] | None = None,
) -> Printed:
    source = f"Table II, {column}-friction mean of five genetic algorithm runs"
    return Printed(value, "free", source, sigma, measured_range)


_BOTH_SURFACES: dict[str, Printed] = {
    "body_mass": Printed(1.242, "measured", _MEASURED),
    "body_inertia": Printed(0.0137, "measured", _MEASURED),
    "foot_dx": Printed(0.105, "measured", _MEASURED),
    "foot_dz": Printed(0.151, "measured", _MEASURED),
    "gravity": Printed(9.81, "fixed", "standard value"),
    "thrust_point_dx": Printed(
        0.225 * math.cos(math.pi / 4),
        "fixed",
        f"{_UNPRINTED}: F450 in X configuration, arms of 0.225 m",
    ),
    "leg_mass_fraction": Printed(0.5, "fixed", f"{_UNPRINTED}: the middle of the leg"),
    "slip_regularization": Printed(
        0.01, "fixed", f"{_UNPRINTED}: a slip speed small against the fitted ones"
    ),
}

# "Measured" column of the fitted rows, footnote c: obtained for validation only.
_RANGES: dict[str, tuple[float, float]] = {
    "leg_axial_stiffness": (5600.0, 6600.0),
    "leg_axial_damping": (3.6, 8.9),
    "leg_bending_stiffness": (14.0, 16.0),
    "leg_bending_damping": (0.009, 0.037),
    "ground_stiffness": (0.4e5, 2.5e5),
}

TABLE_2_LF: dict[str, Printed] = _BOTH_SURFACES | {
    "joint_dx": _fitted("low", 0.088, 0.005),
    "joint_dz": _fitted("low", 0.024, 0.008),
    "leg_axial_stiffness": _fitted("low", 6440.0, 599.0, _RANGES["leg_axial_stiffness"]),
    "leg_axial_damping": _fitted("low", 14.3, 4.6, _RANGES["leg_axial_damping"]),
    "leg_bending_stiffness": _fitted("low", 10.5, 0.3, _RANGES["leg_bending_stiffness"]),
    "leg_bending_damping": _fitted("low", 0.056, 0.045, _RANGES["leg_bending_damping"]),
    "ground_stiffness": _fitted("low", 1.10e5, 0.07e5, _RANGES["ground_stiffness"]),
    "ground_damping": _fitted("low", 0.042, 0.01),
    "leg_mass": Printed(0.02, "measured", _MEASURED),
    "leg_inertia": Printed(2.0e-4, "measured", "Table II, calculated"),
    "kinetic_friction": Printed(0.44, "measured", f"{_MEASURED} on UHMW PE"),
    "static_friction_excess": Printed(0.0, "fixed", "Table II: N/A; the low-friction law has none"),
}

TABLE_2_HF: dict[str, Printed] = _BOTH_SURFACES | {
    "joint_dx": _fitted("high", 0.067, 0.001),
    "joint_dz": _fitted("high", 0.019, 0.007),
    "leg_axial_stiffness": _fitted("high", 6670.0, 350.0, _RANGES["leg_axial_stiffness"]),
    "leg_axial_damping": _fitted("high", 20.3, 1.3, _RANGES["leg_axial_damping"]),
    "leg_bending_stiffness": _fitted("high", 3.44, 0.4, _RANGES["leg_bending_stiffness"]),
    "leg_bending_damping": _fitted("high", 0.017, 0.005, _RANGES["leg_bending_damping"]),
    "ground_stiffness": _fitted("high", 1.49e5, 0.1e5, _RANGES["ground_stiffness"]),
    "ground_damping": _fitted("high", 0.058, 0.036),
    "leg_mass": _fitted("high", 0.015, 0.004, (0.02, 0.02)),
    "leg_inertia": _fitted("high", 2.1e-4, 1.7e-4, (2.0e-4, 2.0e-4)),
    "kinetic_friction": _fitted("high", 0.87, 0.11),
    "static_friction_excess": _fitted("high", 0.08, 0.07),
}


def _sets(
    kind: Literal["motor", "gear"],
    name: str,
    table: ParameterTable,
    printed: dict[str, Printed],
    nrmse: float,
    channels: tuple[tuple[str, str], ...],
    settings: dict[str, Any],
    provenance: dict[str, Any],
    warnings: tuple[str, ...] = (),
) -> ParameterSets:
    unknown = set(printed) - set(table)
    if unknown:
        raise ValueError(f"{name}: the model's table has no {', '.join(sorted(unknown))}")
    # What the model has beyond the paper's tables (instruments of a log) takes its default.
    printed = {
        row.name: printed.get(row.name, Printed(row.nominal, "fixed", f"{_UNPRINTED}: {row.source}"))
        for row in table.values()
    }
    records = tuple(
        ParameterRecord(
            row.name,
            row.symbol,
            row.unit,
            printed[row.name].status,
            row.meaning,
            printed[row.name].source,
            measured_range=printed[row.name].measured_range,
            stated_sigma=printed[row.name].sigma,
        )
        for row in table.values()
    )
    return ParameterSets(
        kind=kind,
        name=name,
        parameters=records,
        values=np.array([[printed[row].value for row in table]]),
        nrmse=np.array([nrmse]),
        runs=(0,),
        seeds=(0,),
        at_bound=np.zeros((1, len(table)), dtype=np.int8),
        trials=(),
        uses=(),
        channels=tuple(channel for channel, _ in channels),
        channel_units=tuple(unit for _, unit in channels),
        channel_weights=(1.0,) * len(channels),
        nrmse_by_trial=np.empty((1, 0, len(channels))),
        settings=settings,
        provenance={"paper": _PAPER, "values": "printed mean over five runs"} | provenance,
        warnings=warnings,
    )


def table_1() -> ParameterSets:
    """Return Table I: DJI 2312, 960 rpm/V, with a 9 x 4.5 inch propeller."""
    return _sets(
        "motor",
        "published-motor",
        motor.PARAMETERS,
        TABLE_1,
        0.0267,
        (("torque", "N·m"), ("speed", "rad/s")),
        {
            "command": "u in [-1, 1]; the paper prints no pulse widths",
            "no_load_speed": "a u + b sign(u), per direction",
            "static_curves": "c2 Ω|Ω| + c1 Ω, per direction",
        },
        {
            "table": "I",
            "values": "printed values of one genetic algorithm",
            "nrmse_denominator": "not printed",
        },
        (
            "k_v and k_t are 0.00995 from the rating of 960 rpm/V: the printed 0.099 cannot be meant.",
            "The static curves and the no-load speed are not printed in the paper.",
        ),
    )


def table_2(surface: Literal["lf", "hf"]) -> ParameterSets:
    """Return a column of Table II: the landing gear of the DJI F450.

    Parameters
    ----------
    surface : {"lf", "hf"}
        Low friction (UHMW PE) or high friction (roofing shingles).
    """
    low = surface == "lf"
    return _sets(
        "gear",
        f"published-gear-{surface}",
        gear.PARAMETERS,
        TABLE_2_LF if low else TABLE_2_HF,
        math.nan,
        (("x_B", "m"), ("z_B", "m"), ("x_B_rate", "m/s"), ("z_B_rate", "m/s"), ("q_B", "rad")),
        {
            "surface": surface,
            "frame": (
                "x down-slope, z up, y into the page; positive pitch turns z toward x; a slope falls "
                "toward +x; rear leg up-slope at -x, front leg at +x; every leg value is of the pair at "
                "that end"
            ),
        },
        {
            "table": "II",
            "nrmse of the five sets, lowest and highest": (0.083, 0.121) if low else (0.133, 0.138),
            "nrmse_denominator": "not printed",
        },
        (
            "The mean of five sets is no fitted set: the paper simulates with the five sets, which it does "
            "not print.",
        ),
    )


def write_published(folder: str | Path) -> tuple[Path, ...]:
    """Write the three sets as JSON.

    Parameters
    ----------
    folder : str or Path
        Made when it does not exist; files of the same names are replaced.

    Raises
    ------
    ExportError
        When a file cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    all_sets = (table_1(), table_2("lf"), table_2("hf"))
    return tuple(export(sets, folder / f"{sets.name}.json") for sets in all_sets)


if __name__ == "__main__":
    for file in write_published(sys.argv[1] if len(sys.argv) > 1 else "data_samples/published"):
        print(file)
