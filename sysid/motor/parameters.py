"""The motor's table of parameters: what each number is, its unit, default, bounds and source.

`sysid.motor.model` has the equations and symbols.
"""

import math
from collections.abc import Mapping

from sysid.errors import UnitError
from sysid.parameters import Parameter, ParameterTable

# A Kv rating outside this range is no multirotor motor; 1 to 100 is the rating given in rad/s/V or V·s/rad.
_KV_PLAUSIBLE_RPM = (10.0, 60_000.0)


def kv_to_si(kv_rpm_per_volt: float) -> float:
    """Return k_v [V·s/rad] = k_m [N·m/A] = 60/(2π Kv) of a Kv rating [rpm/V], as motors are sold, e.g. 960.

    UnitError when the number cannot be a rating in rpm/V.
    """
    low, high = _KV_PLAUSIBLE_RPM
    if not low <= kv_rpm_per_volt <= high:
        raise UnitError(
            f"Kv of {kv_rpm_per_volt:g} rpm/V is not a motor's rating; expected {low:g} to {high:g} rpm/V: "
            f"give it in rpm/V ({kv_rpm_per_volt:g} rad/s/V is {kv_rpm_per_volt * 30 / math.pi:.4g} rpm/V)"
        )
    return 60.0 / (2.0 * math.pi * kv_rpm_per_volt)


_K = kv_to_si(960.0)

_BY_SEARCH = "Table I (genetic algorithm); bounds: guess"
_NO_LOAD = "guess: hover at 512 rad/s loaded needs 642 rad/s without load"
_PROPELLER = "guess for a 9 × 4.5 inch propeller; replaced by the static curves of the campaign"
WAYS = (("forward", "+"), ("reverse", "−"))


def _curve_rows(
    quantity: str, symbol: str, unit: str, forward: float, reverse: float, low: float, high: float
) -> list[Parameter]:
    """Return c2 and c1 of a static curve, forward and reverse; bounds of c2, and c1 up to 100 times them."""
    group, rows = f"{quantity} curve", []
    for (way, sign), value in zip(WAYS, (forward, reverse), strict=True):
        meaning = f"coefficient of the {group}, {way} rotation."
        rows += [
            Parameter(f"{quantity}_quadratic_{way}", f"c2_{symbol}{sign}", f"{unit}·s²/rad²", value, low,
                      high, "log", f"Quadratic {meaning}", _PROPELLER, group),
            Parameter(f"{quantity}_linear_{way}", f"c1_{symbol}{sign}", f"{unit}·s/rad", 0.0, -high * 100.0,
                      high * 100.0, "linear", f"Linear {meaning}", _PROPELLER, group),
        ]  # fmt: skip
    return rows


def instrument_rows() -> list[Parameter]:
    """Return what a log's instruments add: estimated with the motor and reported, no physics of the motor."""
    applied = "; applied to logs, never to the motor."
    rows = (
        ("command_delay", "t_d", 0.2, "Time from a command in the log to the voltage, instruments included; "
         "no motor physics.", "0 on one clock; 30 to 80 ms seen on thrust stands"),
        ("torque_sensor_delay", "t_τ", 0.3,
         f"Time by which the torque sensor trails the speed sensor{applied}",
         "0 on one clock; 30 ms seen on thrust stands, 0.2 s where torque comes at 7 Hz"),
        ("torque_sensor_lag", "T_τ", 0.3,
         f"Time constant of a first-order lag of the torque sensor{applied}",
         "0 for a load cell; 10 to 20 ms seen on thrust stands, 0.1 s where torque comes at 7 Hz"),
        ("speed_sensor_lag", "T_Ω", 0.05, f"Time constant of a first-order lag of the speed sensor{applied}",
         "0: logs of 10 ms rows hardly distinguish it from L/R; free it to see what it buys"),
    )  # fmt: skip
    return [
        Parameter(name, symbol, "s", 0.0, 0.0, upper, "linear", meaning, source, "instrument")
        for name, symbol, upper, meaning, source in rows
    ]


def curve_factor(curve: str, place: str, direction: str) -> str:
    """Return the name of the factor on a measured static curve; see `static_curves.MeasuredCurve`."""
    return f"{curve}_{place}_{direction}"


# Factors on the torque of the static logs and on that of the trials, whose load cells may differ.
LOAD_CELLS = tuple(
    Parameter(f"load_cell_factor_{logs}", f"f_{logs}", "1", 1.0, 0.0, 2.0, "linear",
              f"True torque over that of the load cell, {logs}.", "calibration", "load cell")
    for logs in ("static", "trials")
)  # fmt: skip

PARAMETERS = ParameterTable(
    [
        Parameter("winding_resistance", "R", "Ω", 0.299, 0.05, 2.0, "log",
                  "Resistance of winding, wires and controller, as one direct-current circuit.",
                  _BY_SEARCH, "motor"),
        Parameter("winding_inductance", "L", "H", 0.0038, 1e-5, 2e-2, "log",
                  "Inductance of the same circuit; it stands for everything that delays the current.",
                  "Table I (genetic algorithm), printed in kg; bounds: guess", "motor"),
        Parameter("viscous_damping", "k_d", "N·m·s/rad", 9.2e-9, 1e-10, 1e-4, "log",
                  "Bearing drag per speed.", _BY_SEARCH, "motor"),
        Parameter("back_emf_constant", "k_v", "V·s/rad", _K, 1e-3, 1e-1, "log",
                  "Voltage per speed at no load.",
                  "960 rpm/V rating; Table I's 0.099 is a slip of a factor 10", "motor"),
        Parameter("torque_constant", "k_m", "N·m/A", _K, 1e-3, 1e-1, "log",
                  "Torque per current; equal to k_v in SI (the paper's K_t).", "960 rpm/V rating", "motor"),
        Parameter("rotor_inertia", "I^r", "kg·m²", 2.7e-5, 1e-7, 1e-3, "log",
                  "Moment of inertia of rotor and propeller about the axle.", "Table I (measured)", "motor"),
        Parameter("saturation_current", "I_sat", "A", 0.35, 0.05, 10.0, "log",
                  "Bound of the current while the rotor leaves the dead band.", "Table I (by hand)", "motor"),
        Parameter("saturation_speed", "Ω_min", "rad/s", 6.3, 0.5, 100.0, "log",
                  "Edge of the dead band of a sensorless controller.", "Table I (by hand)", "motor"),
        Parameter("reference_voltage", "V_ref", "V", 11.1, 1.0, 100.0, "linear",
                  "Supply at which Ω_0(u) applies.", "guess: three lithium-polymer cells", "motor"),
        *(
            row
            for way, sign in WAYS
            for row in (
                Parameter(f"no_load_slope_{way}", f"a{sign}", "rad/s", 1030.0, 100.0, 5000.0, "log",
                          f"Slope of the no-load speed over the command u, {way}.", _NO_LOAD, "no-load line"),
                Parameter(f"no_load_intercept_{way}", f"b{sign}", "rad/s", 0.0, -500.0, 500.0, "linear",
                          f"No-load speed that remains as u → 0, {way}; positive raises |Ω_0|.", "guess",
                          "no-load line"),
            )
        ),
        *_curve_rows("thrust", "T", "N", 1.2e-5, 0.62e-5, 1e-9, 1e-3),
        *_curve_rows("torque", "τ", "N·m", 1.65e-7, 1.7e-7, 1e-11, 1e-5),
        *instrument_rows(),
        *(
            Parameter(name, symbol, unit, 0.0, 0.0, upper, "linear", meaning,
                      "0: none, as in the paper; bounds guessed", "term")
            for name, symbol, unit, upper, meaning in (
                ("supply_resistance", "R_s", "Ω", 0.5,
                 "Resistance of battery and wires in front of the controller, which its command scales."),
                ("dead_time_voltage", "V_dead", "V", 1.0,
                 "Voltage that the dead time of the controller's switches takes against the current."),
                ("winding_warming", "w", "1/(A²·s)", 5e-3,
                 "Rise of the resistance per squared current and time, as the winding warms."),
            )
        ),
    ],
    derived=(
        "k2_over_R", "R_over_L", "k_I_sat", "electromechanical_time_constant",
        *(curve_factor(curve, place, way) for curve in ("no_load_line", "torque_curve")
          for place in ("top", "middle") for way in ("forward", "reverse")),
        *(row.name for row in LOAD_CELLS),
    ),
)  # fmt: skip


def parameters_of(known: Mapping[str, float]) -> ParameterTable:
    """Return the table with the bounds of the default motor scaled to another one.

    `known` [SI] are values of the motor, of which V_ref, k_v, k_m and one torque curve count: they give the
    speed without load, and the propeller's torque and current at that speed. A value that `known` lacks is
    the default's; curves keep their bounds, because steady points measure them. So does the edge of the dead
    band: where a start from rest leaves it open, a wider bound lets a fit take it far beyond any real one.
    """
    default = PARAMETERS.nominal
    way = (
        "forward"
        if "torque_quadratic_forward" in known or "torque_quadratic_reverse" not in known
        else "reverse"
    )
    ratios = zip(_sizes(default | dict(known), way), _sizes(default, way), strict=True)
    voltage, speed, torque, current = (here / there for here, there in ratios)
    factors = {
        "winding_resistance": voltage / current, "winding_inductance": voltage / current,
        "supply_resistance": voltage / current, "dead_time_voltage": voltage,
        "viscous_damping": torque / speed, "rotor_inertia": torque / speed,
        "back_emf_constant": voltage / speed, "torque_constant": torque / current,
        "saturation_current": current, "winding_warming": current**-2,
    }  # fmt: skip
    rows = (row.scaled(float(f"{factors.get(name, 1.0):.2g}")) for name, row in PARAMETERS.items())
    return ParameterTable(rows, PARAMETERS.derived)


def _sizes(values: Mapping[str, float], way: str) -> tuple[float, float, float, float]:
    """Return V_ref [V], the speed without load [rad/s], and torque [N·m] and current [A] at that speed."""
    speed = values["reference_voltage"] / values["back_emf_constant"]
    quadratic, linear = (abs(values[f"torque_{term}_{way}"]) for term in ("quadratic", "linear"))
    torque = (quadratic * speed + linear) * speed
    return values["reference_voltage"], speed, torque, torque / values["torque_constant"]


FREE_DEFAULT = ("winding_resistance", "winding_inductance", "viscous_damping")
# Delay and lags of the sensors, in the order in which a comparison takes them.
SENSORS = ("torque_sensor_delay", "torque_sensor_lag", "speed_sensor_lag")
