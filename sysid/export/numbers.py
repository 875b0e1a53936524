"""A motor's numbers by the names under which simulators and flight controllers take them.

`TARGETS` is the table: each number with unit, law and value, each target with the source that defines its
numbers. All are of forward rotation at the set's reference voltage, on a bench whose air stands still.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.documents import interval, rounded
from sysid.errors import ExportError, printable
from sysid.fit.adequacy import NOT_BY
from sysid.motor.model import PARAMETERS, aerodynamic_torque
from sysid.motor.nearest_lag import TIMES, FirstOrderRotor
from sysid.parameter_sets import ADEQUACY, ParameterSets
from sysid.shown import Shown
from sysid.types import FloatArray

if TYPE_CHECKING:
    import pandas as pd

# Standard gravity [m/s²], and the rotors of the drone that the check speaks of.
_GRAVITY, _ROTORS = 9.80665, 4
# Speed of 1 rpm [rad/s].
_RPM = math.pi / 30.0
# ArduPilot's defaults of MOT_SPIN_MIN and MOT_SPIN_MAX, shares of the output range [1].
_SPIN = (0.15, 0.95)
# Ends of a 95 % interval in standard errors.
_NORMAL_95 = 1.96
# A number rests on a parameter if 1 % of the parameter moves it by more than this share [1].
_BUMP, _RESTS = 0.01, 1e-5
_DYNAMIC = PARAMETERS.group("motor")
_STATIC = PARAMETERS.group("no-load line", "thrust curve", "torque curve")
# Key of the settings: no-load lines that come from loaded points and follow the best set.
_TIED = "static_curves_of_best_set"
# First words of the source of a value that nobody stated.
_DEFAULT = "default of the model"


@dataclass(frozen=True)
class Number:
    """One number of a target: its name there, unit, law and value; a plain value is the same for every motor.

    ``name[i]`` is an element of an array. The `law` is a sentence; ``{off:.1f} %`` in it is the `error`,
    by which the motor departs from the law [1].
    """

    name: str
    unit: str
    law: str
    value: Callable[[FirstOrderRotor], float] | float
    error: Callable[[FirstOrderRotor], float] = lambda _: math.nan


@dataclass(frozen=True)
class Format:
    """What a target is, where its numbers are defined, and a line and a comment of its files."""

    title: str
    source: str
    line: str
    comment: str
    numbers: tuple[Number, ...]


def _curve(quantity: str, power: int) -> Callable[[FirstOrderRotor], float]:
    """Return c1 (power 1) or c2 (power 2) of a static curve over rpm instead of rad/s."""
    row = f"{quantity}_{'linear' if power == 1 else 'quadratic'}_forward"
    return lambda r: r.parameters[row] * _RPM**power


def _spin(rotor: FirstOrderRotor) -> tuple[float, float]:
    """Return MOT_SPIN_MIN and MOT_SPIN_MAX [1]."""
    low, high = rotor.limits
    return max(_SPIN[0], low), min(_SPIN[1], high)


_AIR = "0: not identified, it acts on a moving drone, and the air of a bench stands still"
_UP = "lag nearest to the speed after a step up of the command, off by {off:.1f} % of the step (rms)"
_DOWN = "lag nearest to the speed after a step down, off by {off:.1f} % of the step (rms)"
_THRUST = "thrust = {} Ω², off by {{off:.1f}} % of the largest thrust at worst"
# Speed at full command over the fastest measured one from which it is extrapolated [1].
_BEYOND = 1.02
# Command below full that counts as full [1].
_AT_FULL = 5e-3
# Words of a law that holds over the command.
_X = "over the command"
_CURVE = f"thrust t = {{0}} x² + (1 - {{0}}) x {_X} x, off by {{{{off:.1f}}}} % at worst; "
_TOP = "loaded steady speed at full command"
# First words of what a flight controller takes where no motor says otherwise.
_ITS_DEFAULT = "ArduPilot's default"

TARGETS: Mapping[str, Format] = {
    "gazebo": Format(
        "Gazebo's multicopter motor model (gz-sim, PX4 SITL Gazebo classic, RotorS)",
        "gazebosim/gz-sim: src/systems/multicopter_motor_model/MulticopterMotorModel.cc",
        "<{name}>{value}</{name}>",
        "<!-- {} -->",
        (
            Number("timeConstantUp", "s", _UP, lambda r: r.time_constant_up, lambda r: r.misfit_up),
            Number("timeConstantDown", "s", _DOWN, lambda r: r.time_constant_down, lambda r: r.misfit_down),
            Number("maxRotVelocity", "rad/s", _TOP, lambda r: r.maximum_speed),
            Number("motorConstant", "N·s²/rad²", _THRUST.format("motorConstant"),
                   lambda r: r.thrust_constant, lambda r: r.thrust_misfit),
            Number("momentConstant", "m", "drag torque = momentConstant thrust", lambda r: r.moment_constant),
            Number("rotorDragCoefficient", "N·s²/(m·rad)", _AIR, 0.0),
            Number("rollingMomentCoefficient", "N·s²/rad", _AIR, 0.0),
        ),
    ),
    "rotorpy": Format(
        "RotorPy's quad_params",
        "spencerfolk/rotorpy: rotorpy/vehicles/multirotor.py",
        "'{name}': {value},",
        "# {}",
        (
            Number("k_eta", "N·s²/rad²", _THRUST.format("k_eta"),
                   lambda r: r.thrust_constant, lambda r: r.thrust_misfit),
            Number("k_m", "N·m·s²/rad²", "drag torque = k_m Ω²", lambda r: r.torque_constant),
            Number("tau_m", "s", "mean of the lags up and down, which differ from it by {off:.1f} %: RotorPy "
                   "has one", lambda r: (r.time_constant_up + r.time_constant_down) / 2.0,
                   lambda r: abs(1.0 - 2.0 / (1.0 + r.time_constant_up / r.time_constant_down))),
            Number("rotor_speed_max", "rad/s", _TOP, lambda r: r.maximum_speed),
        ),
    ),
    "crazyflow": Format(
        "crazyflow's first_principles dynamics (params.toml), whose speeds are in rpm",
        "learnsyslab/crazyflow: crazyflow/dynamics/first_principles",
        "{name} = {value}",
        "# {}",
        (
            Number("rpm2thrust[1]", "N/rpm", "thrust = [1] rpm + [2] rpm²", _curve("thrust", 1)),
            Number("rpm2thrust[2]", "N/rpm²", "known together with [1]", _curve("thrust", 2)),
            Number("rpm2torque[1]", "N·m/rpm", "drag torque = [1] rpm + [2] rpm²", _curve("torque", 1)),
            Number("rpm2torque[2]", "N·m/rpm²", "known together with [1]", _curve("torque", 2)),
            Number("rotor_dyn_coef[0]", "1/s", f"1/T, {_UP}",
                   lambda r: 1.0 / r.time_constant_up, lambda r: r.misfit_up),
            Number("rotor_dyn_coef[2]", "1/s", f"1/T, {_DOWN}",
                   lambda r: 1.0 / r.time_constant_down, lambda r: r.misfit_down),
            Number("rotor_dyn_coef[3]", "1/(s·rpm)", "0 as [1]: a lag knows no squared speed", 0.0),
            Number("prop_inertia", "kg·m²", "rotor and propeller", lambda r: r.parameters["rotor_inertia"]),
            Number("thrust_max", "N", "thrust at full command", lambda r: r.maximum_thrust),
        ),
    ),
    "px4": Format(
        "PX4's parameters, as QGroundControl loads them",
        "PX4/PX4-Autopilot: module.yaml of src/modules/control_allocator, motor_params.yaml of "
        "src/lib/mixer_module",
        "1\t1\t{name}\t{value}\t9",
        "# {}",
        (
            Number("THR_MDL_FAC", "1", _CURVE.format("THR_MDL_FAC") + "x is 0 at {low:.3g} % and 1 at "
                   "{high:.3g} % of it (minimum and maximum of the PWM output); allowed are 0 to 1",
                   lambda r: r.expo(*r.limits, least=0.0)[0], lambda r: r.expo(*r.limits, least=0.0)[1]),
            Number("CA_ROTOR0_CT", "N", "thrust = CT u² at full command u = 1; the same for every rotor",
                   lambda r: r.maximum_thrust),
            Number("CA_ROTOR0_KM", "m", "drag torque = KM thrust; negative for rotors that turn clockwise",
                   lambda r: r.moment_constant),
        ),
    ),
    "ardupilot": Format(
        "ArduPilot's parameters",
        "ArduPilot/ardupilot: libraries/AP_Motors/AP_Motors_Thrust_Linearization.cpp",
        "{name},{value}",
        "# {}",
        (
            Number("MOT_THST_EXPO", "1", _CURVE.format("MOT_THST_EXPO") + "x is 0 at MOT_SPIN_MIN and 1 at "
                   "MOT_SPIN_MAX", lambda r: r.expo(*_spin(r))[0], lambda r: r.expo(*_spin(r))[1]),
            Number("MOT_SPIN_MIN", "1", f"{_ITS_DEFAULT}, or where thrust begins {_X} if that is higher",
                   lambda r: _spin(r)[0]),
            Number("MOT_SPIN_MAX", "1", f"{_ITS_DEFAULT}, or from where on thrust does not rise any more "
                   f"{_X}",
                   lambda r: _spin(r)[1]),
        ),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Given:
    """A number of a target as a motor gives it [`unit`].

    `ends` are the ends of its 95 % interval, None where it is exact or has no known interval; `why_not`
    is the sentence that says what is missing, and the value is NaN then.
    """

    name: str
    unit: str
    value: float
    ends: tuple[float, float] | None
    law: str
    why_not: str = ""

    @property
    def comment(self) -> str:
        """Unit, interval and law."""
        unit = "no unit" if self.unit == "1" else self.unit
        known = f"; 95 % {interval(self.ends, (False, False))}" if self.ends else ""
        _, bracket, index = self.name.partition("[")
        return f"{bracket}{index}{' ' if index else ''}{unit}{known}; {self.law}"


@dataclass(frozen=True, repr=False)
class TargetNumbers(Shown):
    """A motor's numbers for a target; `check` says in a sentence what they amount to."""

    target: str
    name: str
    rank: int
    rows: tuple[Given, ...]
    check: str
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<TargetNumbers of {self.name}, set {self.rank}, for {self.target}: {len(self.rows)}>"

    @property
    def missing(self) -> tuple[str, ...]:
        """What cannot be given, a sentence each."""
        return tuple(row.why_not for row in self.rows if row.why_not)

    def to_frame(self) -> pd.DataFrame:
        """Return value, unit, ends of the 95 % interval (NaN where there is none) and law by name."""
        import pandas as pd

        none = (math.nan, math.nan)
        rows = [(row.value, row.unit, *(row.ends or none), row.why_not or row.law) for row in self.rows]
        columns = ["value", "unit", "interval_low", "interval_high", "law"]
        return pd.DataFrame(
            rows, index=pd.Index([row.name for row in self.rows], name="number"), columns=columns
        )

    def remarks(self) -> tuple[str, ...]:
        """Return the check and the notes."""
        return (self.check, *self.notes)

    def document(self) -> dict[str, object]:
        """Return the numbers as the command prints them for programs."""
        rows = [vars(row) for row in self.rows]
        return {"target": self.target, "name": self.name, "rank": self.rank, "numbers": rows} | {
            "check": self.check, "notes": list(self.notes),
        }  # fmt: skip

    def text(self) -> str:
        """Return a fragment of the target's own file, with all else in comments."""
        form = TARGETS[self.target]
        head = f"{form.title}: {self.name}, set {self.rank}, written by sysid."

        def said(sentence: str) -> str:
            # Two hyphens end an XML comment; a new line ends a comment of the other formats.
            return form.comment.format(re.sub("-(?=-)", "- ", " ".join(printable(sentence).split())))

        lines = [*map(said, (head, f"Source: {form.source}", *self.notes))]
        for base, group in groupby(self.rows, lambda row: row.name.partition("[")[0]):
            rows = list(group)
            lines += [said(row.why_not or row.comment) for row in rows]
            if not any(row.why_not for row in rows):
                lines.append(form.line.format(name=base, value=_literal(rows)))
        return "\n".join([*lines, said(f"Check: {self.check}")]) + "\n"


def _literal(rows: list[Given]) -> str:
    """Return a number, or the array of several elements, those without a row 0."""
    values = {row.name.partition("[")[2].rstrip("]"): f"{row.value:.6g}" for row in rows}
    if "" in values:
        return values[""]
    last = max(map(int, values))
    return f"[{', '.join(values.get(str(i), '0.0') for i in range(last + 1))}]"


def numbers_for(
    sets: ParameterSets, target: str, *, rank: int = 1, mass: float | None = None
) -> TargetNumbers:
    """Return the numbers of the set of a `rank` of a motor; the `mass` [kg] is of a drone with four such.

    ExportError when the target is unknown, the sets are no motor's, or they give none of its numbers. See
    `sysid.numbers_for`.
    """
    form = TARGETS.get(str(target))
    if form is None:
        raise ExportError(f"unknown target {target!r:.60}; expected one of {', '.join(TARGETS)}")
    if mass is not None and not mass > 0:
        raise ExportError(f"mass = {mass!r}: expected a number above 0, in kg").also(ValueError)
    if sets.kind != "motor":
        raise ExportError(f"{target} takes a motor's numbers; {sets.name} has {sets.kind} sets")
    times, supply, commanded = _seen(sets)
    levels = np.array(supply["measured"])[:, :2] if supply else None
    known = dict(sets.set_values(rank)) | {name: float(row["value"]) for name, row in times.items()}
    rotor = FirstOrderRotor(known, levels)
    values = np.array([_value(number, rotor) for number in form.numbers])

    def moved(changed: dict[str, float], faster: float = 0.0) -> FloatArray:
        others = None if levels is None else levels * [1.0, 1.0 + faster]
        other = FirstOrderRotor(known | changed, others)
        return np.array([_value(number, other) for number in form.numbers]) - values

    below, above = np.zeros(len(values)), np.zeros(len(values))
    of_times = [tuple({name: end} for end in row["interval_95"]) for name, row in times.items()]
    repeats = _NORMAL_95 * (supply.get("repeats") or 0.0)
    for both in (
        *(np.array([moved(end) for end in ends]) for ends in (*of_times, *_ends(sets, known, rotor))),
        np.array([moved({}, -repeats), moved({}, repeats)]),
    ):
        below += np.minimum(both, 0.0).min(axis=0) ** 2
        above += np.maximum(both, 0.0).max(axis=0) ** 2
    unsure = np.zeros(len(values), dtype=bool)
    guesses: list[list[str]] = [[] for _ in values]
    for name, guessed in _unsure(sets):
        rests = np.abs(moved({name: known[name] * (1.0 + _BUMP)})) > _RESTS * np.abs(values)
        unsure |= rests
        for i in np.flatnonzero(rests & guessed):
            guesses[i].append(name)
    forward = [name for name in known if name in PARAMETERS and not name.endswith("_reverse")]
    unknown = [name for name in forward if math.isnan(known[name])]
    rows = []
    for number, number_value, guessed_ones, low, high, open_end in zip(
        form.numbers, values.tolist(), guesses, below, above, unsure, strict=True
    ):
        value, why, law = number_value, "", number.law
        if not commanded and law == _TOP:
            law = "fastest steady speed of the logs, none of which has a command"
        elif not commanded and law.startswith(_ITS_DEFAULT):
            law = f"{_ITS_DEFAULT}: without a logged command nothing shows whether this motor needs another"
        lacking = guessed_ones or ([] if commanded or _X not in law else ["command"])
        if math.isnan(value) or lacking:
            value = math.nan
            why = (
                f"{number.name} cannot be given: {', '.join(lacking or unknown)} not measured; record what "
                "determines it, or state it in the campaign, and fit again"
            )
            if lacking == ["command"]:
                why = f"{number.name} cannot be given: no log has a command; record it beside the speed"
        elif times and "lag nearest" in law:
            law = "median over the steps of the logs, which show it without the model"
        else:
            first, last = (100.0 * end for end in rotor.limits)
            law = law.format(off=100.0 * number.error(rotor), low=first, high=last)
        wide = not why and not open_end and low + high > 0.0
        pair = (value - math.sqrt(low), value + math.sqrt(high)) if wide else None
        rows.append(Given(number.name, number.unit, value, pair, law, why))
    if all(row.why_not or not callable(number.value) for row, number in zip(rows, form.numbers, strict=True)):
        raise ExportError(f"{sets.name}, set {rank}: {rows[0].why_not}")
    notes = (*_notes(sets, rotor, supply, commanded), *_limited(form, rotor, supply))
    return TargetNumbers(target, sets.name, rank, tuple(rows), _check(form, rotor, mass), notes)


def _value(number: Number, rotor: FirstOrderRotor) -> float:
    try:
        return number.value(rotor) if callable(number.value) else number.value
    except ExportError:
        return math.nan


def _ends(
    sets: ParameterSets, known: Mapping[str, float], rotor: FirstOrderRotor
) -> Iterator[tuple[dict[str, float], dict[str, float]]]:
    """Yield values at both ends of each judged parameter's 95 % interval, and along each curve's errors."""
    tied = bool(sets.settings.get(_TIED))
    for name, row in sets.known.items():
        if name in PARAMETERS and row.judged:
            low, high = ({name: end} for end in row.judged.interval_95)
            yield (_tied(rotor, low), _tied(rotor, high)) if tied and name in _DYNAMIC else (low, high)
    calibration = sets.settings.get("stand", {}).get("calibration", 0.0)
    for names, (first, second), rho in _errors(sets):
        roots = [(first, rho * second), (0.0, math.sqrt(1.0 - rho**2) * second)]
        if names[0].startswith(("thrust", "torque")):
            roots.append((calibration * known[names[0]], calibration * known[names[1]]))
        for root in roots:
            low, high = (
                {name: known[name] + side * _NORMAL_95 * size for name, size in zip(names, root, strict=True)}
                for side in (-1.0, 1.0)
            )
            yield low, high


def _tied(rotor: FirstOrderRotor, changed: dict[str, float]) -> dict[str, float]:
    """Return changed values with the no-load line that keeps the loaded speeds, which were measured."""
    commands = np.array([0.5, 1.0])
    return changed | FirstOrderRotor(rotor.parameters | changed).line_through(commands, rotor.speed(commands))


def _seen(sets: ParameterSets) -> tuple[dict[str, Any], Mapping[str, Any], bool]:
    """Return what logs show without the model: times of the speed's steps, forward supply law, any command.

    The times serve where the model does not explain the logs, the law where its levels are no line of the
    command; else it is empty.
    """
    stand, law = sets.settings.get("stand"), sets.settings.get("supply_law")
    times = stand.get("times", {}) if isinstance(stand, Mapping) else {}
    forward = law.get("forward", {}) if isinstance(law, Mapping) else {}
    is_map = forward.get("law") == "map" and "measured" in forward
    unexplained = sets.provenance.get(ADEQUACY, {}).get("verdict") == NOT_BY
    # The dead time of a step is known where a log has the command.
    commanded = not times or "dead_time" in times
    seen = {name: times[name] for name in TIMES if name in times and unexplained}
    return seen, forward if is_map else {}, commanded


def _errors(sets: ParameterSets) -> Iterator[tuple[tuple[str, ...], tuple[float, float], float]]:
    """Yield names, standard errors and correlation of the two coefficients of each forward curve."""
    for key in ("static_curves", _TIED):
        curves = sets.settings.get(key)
        for curve in curves if isinstance(curves, list) else ():
            names = tuple(n for n in _STATIC if n.startswith(curve["quantity"]) and n.endswith("forward"))
            first, second = curve["standard_errors"]
            if curve["direction"] == "forward" and math.isfinite(first) and math.isfinite(second):
                yield names, (first, second), curve["correlation"]


def _unsure(sets: ParameterSets) -> Iterator[tuple[str, bool]]:
    """Yield the parameters of whose error nothing is known, and whether nobody stated their value either."""
    errors = {name for names, _, _ in _errors(sets) for name in names}
    for name, row in sets.known.items():
        if name not in PARAMETERS or (row.judged and row.judged.verdict != "not_interpretable"):
            continue
        guessed = row.record.status == "fixed" and row.record.source.startswith(_DEFAULT)
        if guessed or row.record.status == "free" or (name in _STATIC and name not in errors):
            yield name, guessed


def _check(form: Format, rotor: FirstOrderRotor, mass: float | None) -> str:
    """Return what the motor and four of it do at full command, in a sentence."""
    speed, force = rotor.maximum_speed, rotor.maximum_thrust
    if not math.isfinite(force):
        return "nothing to check: the thrust at full command is unknown."
    top = next((number.name for number in form.numbers if number.law == _TOP), "full command")
    torque = float(aerodynamic_torque(speed, rotor.parameters))
    lift = _ROTORS * force / _GRAVITY
    out = (
        f"at {top}, {rounded(speed)} rad/s, one rotor gives {rounded(force)} N and {rounded(torque)} N·m; "
        f"four lift {rounded(lift)} kg at most"
    )
    if mass is None:
        return f"{out}."
    share = mass / lift
    if share > 1:
        return f"{out}, so they do not lift {mass:g} kg."
    return (
        f"{out} and hover {mass:g} kg at {100.0 * math.sqrt(share):.0f} % of that speed and "
        f"{100.0 * share:.0f} % of that thrust."
    )


def _limited(form: Format, rotor: FirstOrderRotor, law: Mapping[str, Any]) -> Iterator[str]:
    """Yield where the supply ends the rise of the thrust, and what a stiff supply would make of the curve."""
    curve = next((number for number in form.numbers if _X in number.law), None)
    _, high = rotor.limits
    if curve is None or high == 1.0:
        return
    u, speed, ratio = np.array([level for level in law["measured"] if level[0] <= high]).T
    stiff = FirstOrderRotor(rotor.parameters, np.column_stack([u, speed / ratio]))
    yield (
        f"The supply limits the speed above {100 * high:.3g} % of the command, where it does not rise any "
        f"more: curves over the command end there, so limit the output there. {curve.name} has the supply's "
        f"sag inside; with a voltage that stays it would be about {_value(curve, stiff):.2g}."
    )


def _notes(
    sets: ParameterSets, rotor: FirstOrderRotor, law: Mapping[str, Any], commanded: bool
) -> tuple[str, ...]:
    """Return what holds for all numbers: what is exact, full command and its supply, the fit's verdict."""
    stand = sets.settings.get("stand", {})
    calibration, curves = stand.get("calibration"), stand.get("curves", ())
    fitted = {row.name for row in sets.parameters if row.status in ("stated", "free")}
    # Where the campaign states errors, the intervals of R and L contain that of Kv.
    kv = "the error of Kv as far as R and L have it" if "back_emf_constant" in fitted else "Kv as exact"
    exact = f"the inertia as {'fitted' if 'rotor_inertia' in fitted else 'exact'}, {kv}"
    out = [f"Intervals take {exact}, and the calibration of the load cell as exact."]
    if calibration is not None:
        out = [
            f"Intervals take {exact}; thrust and torque have "
            f"{100 * calibration:g} % (one standard deviation) for the calibration of the load cells."
        ]
    forward = [row for row in curves if row["direction"] == "forward"]
    top = max((row["speed"] for row in forward if not row.get("common")), default=0.0)
    # The last round speed among the steady points, and the next one.
    speeds = sorted(
        {row["speed"] for row in forward if row.get("common")}, key=lambda speed: abs(speed - top)
    )[:2]
    words = (
        f"{row['quantity']} {rounded(row['value'])} {'N' if row['quantity'] == 'thrust' else 'N·m'} (95 % "
        f"{interval(tuple(row['interval_95']), (False, False))}) at {row['speed']:g} rad/s"
        for row in forward
        if row["speed"] in speeds
    )
    if speeds:
        out.append(
            f"To compare with other logs of this propeller: {', '.join(words)}; steady points end at "
            f"{rounded(top)} rad/s."
        )
    command: Mapping[str, Any] = sets.settings.get("command", {})
    protocol = isinstance(command, Mapping) and {"minimum", "maximum", "unit"} <= {*command}
    volts, supply = float(sets.best["reference_voltage"]), "a supply that stays at"
    last, fastest, ratio = law["measured"][-1] if law else (1.0, math.inf, 1.0)
    if law:
        volts *= ratio
        supply = "the stand's own supply, which sags with the load: it has"
    elif rotor.maximum_speed > _BEYOND * max((abs(one["speed"]) for one in curves), default=math.inf):
        fastest = max(abs(one["speed"]) for one in curves)
        out.append(
            f"The logs end at {rounded(fastest)} rad/s: the speed at full command, "
            f"{rounded(rotor.maximum_speed)} rad/s, and its thrust are extrapolated to a supply that does "
            "not sag, which no log shows."
        )
    if law and last < 1.0 - _AT_FULL:
        out.append(
            f"Full command lies beyond the logs, which end at {100 * last:.3g} % of it with "
            f"{rounded(fastest)} rad/s: what is stated of full command is extrapolated from the last levels."
        )
    if not commanded:
        out.append(
            "No log has a command: full command stands for the fastest steady speed of the logs, "
            f"{rounded(rotor.maximum_speed)} rad/s at {volts:.4g} V, which the motor may exceed."
        )
    elif protocol:
        start = command["neutral"] if command.get("bidirectional") else command["minimum"]
        unit = "" if command["unit"] == "1" else f" {command['unit']}"
        where = f" at {100 * last:.3g} % of full command" if law else ""
        out.append(
            f"Full command is {command['maximum']:g}{unit}, none is {start:g}{unit}, at {supply} "
            f"{volts:.4g} V{where}."
        )
    if judged := sets.provenance.get(ADEQUACY):
        out.append(f"Fit {judged['sentence']}.")
    return tuple(out)
