"""A motor campaign after its logs were read: trials, static curves and the values that they determine."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sysid.campaign import MotorCampaign, MotorTrial
from sysid.errors import CampaignError
from sysid.fit.trial import name_order
from sysid.journal import notice
from sysid.motor.bench_logs import BenchLog, TorquePerCurrent, bench_log, check_options, torque_per_current
from sysid.motor.curves import CurveLog, StaticCurves, read_curve_logs, static_curves
from sysid.motor.inertia import spike_inertia
from sysid.motor.log_delays import with_log_delays
from sysid.motor.model import FREE_DEFAULT, PARAMETERS
from sysid.motor.parameters import LOAD_CELLS, parameters_of
from sysid.motor.stand import lost_power, rpm
from sysid.motor.static_curves import MeasuredCurve, NoLoadTie, no_load_line, turns
from sysid.motor.targets import PreparedTrial, prepare_run
from sysid.parameters import SearchSpace
from sysid.stated import Stated, error_of
from sysid.trials.steady import SteadyPoints
from sysid.types import Rotation

# Loaded speed at full command over the unloaded one, V_ref/k_v [1], about: a guess for motors of unknown Kv,
# on which only the scale of a result depends.
_LOADED_SHARE = 0.8
# Speed over the fastest steady point from which a trial is beyond the static curves [1].
_BEYOND = 1.1
# Limits of Kv V_ref over the speed at full command [1], which is 1 to a few percent without propeller and 1.1
# to 2 with one.
_KV_NO_LOAD, _KV_LOADED = (0.7, 1.5), (0.8, 2.8)
# Parameters of the dead band, fitted to reversals after everything else, never with it.
SATURATION = ("saturation_current", "saturation_speed")
# Constants of the motor, equal in SI; without one of them torque and speed determine R, L and I_sat only up
# to a common scale.
CONSTANTS = ("back_emf_constant", "torque_constant")
# Key of the campaign by the parameter that it states, where their names differ.
KEYS = MappingProxyType({"back_emf_constant": "kv"})
NO_INDUCTANCE = (
    "L is not fitted: the winding settles between two rows of such logs, so the fit takes the smallest L of "
    "the model; record torque and speed at 1 kHz or more to determine R and L"
)
# Factor between a stated value and the logs that only a wrong unit explains [1].
_ABSURD = 10.0
# Command from which the supply's current is the motor's [1], and the least ratio of an exact Kv to the
# highest one that this current allows, at which Kv or current is wrong [1].
_FULL, _KV_ABOVE = 0.99, 1.05
# Largest relative error of a rating that agrees with the logged current [1].
_SCALE_AGREES = 0.1


@dataclass(frozen=True, eq=False)
class Bench:
    """A motor campaign after its logs were read."""

    trials: tuple[PreparedTrial, ...]
    curves: StaticCurves
    values: dict[str, float]  # parameters that the campaign or its static logs state, by name [SI]
    measured: Mapping[str, str]  # sources of the measured ones
    stated: Mapping[str, str]  # sources of the others: a rating, a guess
    scale_known: bool  # whether a Kv, a motor current or the campaign determines the scale of R, L, I_sat
    guessed: frozenset[str]  # names of guesses

    @property
    def fitted(self) -> tuple[PreparedTrial, ...]:
        """Trials of the dynamic fit: use "fit", and no reversal; in the order of `name_order`."""
        return _in_order(trial for trial in self.trials if in_search(trial.entry))

    @property
    def laws(self) -> dict[Rotation, NoLoadTie]:
        """Supply laws from loaded levels of logged commands, by direction."""
        return self.curves.ties if all(trial.log.commanded for trial in self.fitted) else {}

    @cached_property
    def measured_curves(self) -> tuple[MeasuredCurve, ...]:
        """Curves of logs under `[curves]`: those of the trials' own levels measure nothing beside them."""
        named = {(log.table, log.entry.direction) for log in self.curves.logs}
        out = []
        for fit in self.curves.fits:
            table = "no_load" if fit.quantity == "no_load" else "static"
            if fit.quantity != "thrust" and (table, fit.direction) in named:
                reach = self.curves.loaded[fit.direction].speed if table == "static" else np.ones(1)
                top = float(np.max(np.abs(reach))) * (1.0 if fit.direction == "forward" else -1.0)
                out.append(MeasuredCurve.of(fit, top))
        return tuple(curve for curve in out if curve is not None)

    @cached_property
    def volts(self) -> int:
        """Power of V_ref with which the voltage at a command goes [1]; 0 where the logs take it out again.

        Curves whose points have volts give Ω_0 at V_ref, trials without volts run at V_ref.
        """
        points = [log.points for log in self.curves.logs if log.table == "no_load"]
        points += [self.curves.loaded[direction] for direction in self.curves.ties]
        curves = {bool(np.isfinite(each.voltage).any()) for each in points}
        trials = {"voltage" in trial.log.channels for trial in self.fitted}
        lines = [fit for fit in self.curves.fits if fit.quantity == "no_load"]
        follow = all(any(fit is each.fit for each in self.measured_curves) for fit in lines)
        if self.curves.maps or not follow or len(curves) != 1 or len(trials) != 1:
            return 0
        return int(curves.pop()) - int(trials.pop())

    @property
    def banded(self) -> tuple[PreparedTrial, ...]:
        """Trials that show the dead band: reversals of use "fit", or else fitted starts from rest."""
        reversals = (t for t in self.trials if t.entry.use == "fit" and t.entry.direction == "reversal")
        return _in_order(reversals) or tuple(t for t in self.fitted if t.shows_start)


def _in_order(trials: Iterable[PreparedTrial]) -> tuple[PreparedTrial, ...]:
    return tuple(sorted(trials, key=lambda trial: name_order(trial.entry.name)))


def in_search(entry: MotorTrial) -> bool:
    """Return whether the dynamic fit sees a trial; reversals come after it, as in the paper."""
    return entry.use == "fit" and entry.direction != "reversal"


def prepare_bench(campaign: MotorCampaign, path: str | Path) -> Bench:
    """Read every log of a campaign, fit the static curves and prepare the trials.

    SysidError for the first log that cannot be used, or a campaign that has nothing to fit.
    """
    check_options(campaign, path)
    logs = [bench_log(campaign, path, entry) for entry in campaign.trials]
    fitted = [log for log, entry in zip(logs, campaign.trials, strict=True) if in_search(entry)]
    fitted.sort(key=lambda log: name_order(log.name))
    if not fitted:
        raise CampaignError(
            "no forward or reverse trial has use = 'fit'; reversals alone cannot serve, because the dead "
            "band would hide in R and L"
        )
    curve_logs = read_curve_logs(campaign, path)
    reference, voltage_source, guessed = _reference_voltage(campaign, curve_logs, fitted)
    curves = static_curves(campaign, curve_logs, fitted, reference)
    if campaign.motor.kv is not None:
        _check_kv(campaign.motor.kv, reference, curves)
    current = torque_per_current(fitted) if campaign.log.current == "motor" else None
    values, measured, stated = _known_values(campaign, curves, reference, voltage_source, current)
    _check_ratings(campaign, fitted, curve_logs, values)
    points = SteadyPoints.join(list(curves.loaded.values()))
    commanded = all(log.commanded for log in fitted) and all(log.commanded for log in curve_logs)
    if campaign.motor.kv is not None and campaign.log.current == "supply" and commanded:
        _check_kv_at_full_command(campaign, points)
    slow = not any(log.fast for log in fitted) and campaign.log.current == "supply"
    power = None
    if slow and campaign.motor.kv is not None and curves.ties:
        power = lost_power(points, values["torque_constant"])
    if power is not None and power.resistance > 0:
        # The winding settles between two rows of a slow log: the lost power shows R, and nothing shows L.
        values["winding_resistance"] = power.resistance
        measured["winding_resistance"] = (
            f"lost power of {len(power.speeds)} steady levels under the rating's Kv, 95 % from "
            f"{power.interval_95[0]:.3g} to {power.interval_95[1]:.3g} Ω"
        )
        values["winding_inductance"] = PARAMETERS["winding_inductance"].lower
        stated["winding_inductance"] = "guess: the winding settles between two rows of a slow log"
    chosen, rated = campaign.parameters, campaign.motor.kv is not None or current is not None
    # One constant alone says nothing where the other is a guess.
    scale_known = rated or all(name in chosen.fixed for name in CONSTANTS)
    # Freed together with R, the constants are arbitrary whatever they start from.
    scale_known &= current is not None or not {*CONSTANTS} & {*(chosen.free or ())}
    trials = tuple(
        prepare_run(campaign, entry, log, curves) for entry, log in zip(campaign.trials, logs, strict=True)
    )
    _notice_extrapolation(trials, curves)
    guesses = {"winding_inductance"} | ({"reference_voltage"} if guessed else set())
    guesses |= set() if rated else {*CONSTANTS}
    guesses &= {*stated}
    return Bench(trials, curves, values, measured, stated, scale_known, frozenset(guesses))


def _notice_extrapolation(trials: Sequence[PreparedTrial], curves: StaticCurves) -> None:
    """Notice trials that turn faster than the static points, where thrust and torque are extrapolated."""
    for direction, points in curves.loaded.items():
        fastest = float(np.max(np.abs(points.speed[turns(points.speed, direction)])))
        for trial in trials:
            speed = trial.target.measured[trial.target.valid[:, 1], 1]
            top = float(np.max(np.abs(speed[turns(speed, direction)]), initial=0.0))
            if top > _BEYOND * fastest:
                notice(
                    "beyond-static-points",
                    f"turns at up to {top:.4g} rad/s, the {direction} steady points end at {fastest:.4g} "
                    "rad/s: beyond them thrust and torque are extrapolated; record steady points up to "
                    "full command",
                    trial=trial.entry.name,
                )


def _check_kv(kv: float, reference: float, curves: StaticCurves) -> None:
    """Refuse a Kv that is off by about 60/(2π), its unit; notice one that the logs merely find odd."""
    bare = [sum(fit.coefficients) for fit in curves.fits if fit.quantity == "no_load"]
    loaded = [float(np.sum(tie.lines[0])) for tie in curves.ties.values()]
    top = max(abs(speed) for speed in (*bare, *loaded))
    what = "without" if bare else "with"
    ratio = kv * reference / top
    low, high = _KV_NO_LOAD if bare else _KV_LOADED
    slip = rpm(1.0)
    sentence = (
        f"motor.kv: {kv:.4g} rad/s/V ({rpm(kv):.4g} rpm/V) at {reference:.3g} V would turn the unloaded "
        f"motor at {kv * reference:.4g} rad/s, the logs {what} propeller show {top:.4g} rad/s at full command"
    )
    if low * slip <= ratio <= high * slip:
        raise CampaignError(f'{sentence}; {kv:.4g} looks like rpm/V: write kv = "{kv:.4g} rpm/V"')
    if low <= ratio * slip <= high:
        raise CampaignError(
            f'{sentence}; {rpm(kv):.4g} looks like rad/s/V: write kv = "{rpm(kv):.4g} rad/s/V"'
        )
    if not low / _ABSURD <= ratio <= high * _ABSURD:
        raise CampaignError(f"{sentence}; correct kv or reference_voltage, and their units")
    if not low <= ratio <= high:
        notice("odd-kv", f"{sentence}; check kv and reference_voltage")


def _check_kv_at_full_command(campaign: MotorCampaign, points: SteadyPoints) -> None:
    """Notice a Kv that needs more current than the supply gives at full command.

    Where the controller's duty is 1, as it is at full command unless it is limited, the supply's current is
    the motor's, which makes the torque τ = I/Kv at most. Friction and iron losses make it less.
    """
    kv = campaign.motor.kv
    full = (np.abs(points.u) > _FULL) & (np.abs(points.torque) > 0) & (np.abs(points.current) > 0)
    if kv is None or not full.any():
        return
    current, torque = np.abs(points.current[full]), np.abs(points.torque[full])
    middle = int(np.argsort(current / torque)[(len(torque) - 1) // 2])
    most = float(current[middle] / torque[middle])
    unsure = 2.0 * float(np.hypot(error_of(kv) / kv, campaign.log.calibration_error))
    if kv > (_KV_ABOVE + unsure) * most:
        notice(
            "kv-above-current",
            f"motor.kv: {rpm(kv):.4g} rpm/V would need {kv * torque[middle]:.4g} A for the "
            f"{torque[middle]:.3g} N·m at full command, and the supply gave {current[middle]:.4g} A, which "
            f"allows {rpm(most):.4g} rpm/V at most: measure Kv (speed over supply voltage without "
            "propeller), or correct the current, the torque, or a command.maximum below the controller's "
            "full throttle; R and L change as 1/Kv²",
        )


def _check_ratings(
    campaign: MotorCampaign,
    fitted: Sequence[BenchLog],
    curve_logs: Sequence[CurveLog],
    values: dict[str, float],
) -> None:
    """Refuse a supply or an inertia that is `_ABSURD` times what the logs show: a slip of a unit."""
    motor = campaign.motor
    volts = [log.channels["voltage"][1] for log in fitted if "voltage" in log.channels]
    volts += [log.points.voltage for log in curve_logs]
    shown = {"reference_voltage": float(np.nanmedian(np.concatenate([*volts, [np.nan]])))} if volts else {}
    if motor.rotor_inertia is not None:
        spikes = spike_inertia(campaign, fitted, PARAMETERS.nominal | values)
        # Of slow logs a spike is mostly noise.
        if spikes.error["up"] < 0.2 * spikes.value["up"]:
            shown["rotor_inertia"] = spikes.value["up"]
    for name, seen in shown.items():
        value, unit = getattr(motor, name), PARAMETERS[name].unit
        if value is not None and np.isfinite(seen) and not 1 / _ABSURD <= value / seen <= _ABSURD:
            raise CampaignError(
                f"motor.{name} = {value:.4g} {unit} is {value / seen:.2g} × the {seen:.3g} {unit} that the "
                "logs show: correct the value or its unit"
            )


def _reference_voltage(
    campaign: MotorCampaign, curve_logs: Sequence[CurveLog], fitted: list[BenchLog]
) -> tuple[float, str, bool]:
    """Return V_ref [V], its source, and whether it is a guess."""
    if campaign.motor.reference_voltage is not None:
        return campaign.motor.reference_voltage, "campaign: motor.reference_voltage", False
    logged = [log.channels["voltage"][1] for log in fitted if "voltage" in log.channels]
    if logged:
        return float(np.median(np.concatenate(logged))), "median supply voltage of the fitted logs", False
    # Static speeds are divided by the volts of their rows: another reference would tilt the no-load line.
    volts = np.concatenate([np.zeros(0), *(log.points.voltage for log in curve_logs)])
    volts = volts[np.isfinite(volts) & (volts > 0)]
    if volts.size:
        source = "median supply voltage of the logs under [curves]: the fitted logs have none"
        return float(np.median(volts)), source, False
    return PARAMETERS.nominal["reference_voltage"], "guess: no log has the supply voltage", True


def _known_values(
    campaign: MotorCampaign,
    curves: StaticCurves,
    reference: float,
    voltage_source: str,
    current: TorquePerCurrent | None,
) -> tuple[dict[str, float], dict[str, str], dict[str, str]]:
    """Return the values that campaign and logs give, and the sources of the measured and of the others."""
    motor = campaign.motor
    values = {**curves.parameters, "reference_voltage": reference}
    measured = dict.fromkeys(curves.parameters, "steady points of the logs")
    stated: dict[str, str] = {}
    (stated if motor.reference_voltage is None else measured)["reference_voltage"] = voltage_source
    if motor.kv is not None:
        kv, assumed = motor.kv, getattr(motor.kv, "assumed", "")
        values |= dict.fromkeys(CONSTANTS, Stated(1.0 / kv, error_of(kv) / kv**2, assumed))
        stated |= dict.fromkeys(CONSTANTS, "campaign: 1/motor.kv, a rating")
        if current is not None and abs(current.value * motor.kv - 1.0) > _SCALE_AGREES:
            notice(
                "kv-against-current",
                f"motor.kv says {1.0 / motor.kv:.4g} N·m/A, torque over the logged motor current "
                f"{current.value:.4g} ± {current.error:.2g} N·m/A: the fit uses the rating; leave motor.kv "
                "out to use the current, or correct log.current",
            )
    elif current is not None:
        values |= dict.fromkeys(CONSTANTS, Stated(current.value, current.error))
        source = f"torque over the logged motor current, {current.points} steady points"
        if current.friction > 0:
            source += f" less {1e3 * current.friction:.2g} mN·m of friction"
        measured |= dict.fromkeys(CONSTANTS, f"{source}, ± {current.error:.2g} N·m/A; k_v = k_m")
    elif curves.ties:
        top = max(float(np.sum(tie.lines[0])) for tie in curves.ties.values())
        values |= dict.fromkeys(CONSTANTS, _LOADED_SHARE * reference / top)
        stated |= dict.fromkeys(CONSTANTS, "guess from supply and loaded speed: the campaign gives no Kv")
    if motor.kv is None and current is None and not set(CONSTANTS) <= set(campaign.parameters.fixed):
        notice(
            "no-kv",
            "no Kv in the campaign: R, L and I_sat rest on a guessed motor constant of "
            f"{values.get('torque_constant', PARAMETERS.nominal['torque_constant']):.4g} N·m/A; torque and "
            "speed determine only k²/R, R/L and k·I_sat, which the result lists",
        )
    for name in ("rotor_inertia", *SATURATION):
        value = getattr(motor, name)
        if value is not None:
            values[name] = value
            measured[name] = f"campaign: motor.{name}"
    return values, measured, stated


def untested_rows(campaign: MotorCampaign, bench: Bench) -> tuple[str, ...]:
    """Return curves and no-load speed of a direction of which no log says anything."""
    known = {*bench.values, *campaign.parameters.fixed, *(campaign.parameters.free or ())}
    known |= {name for direction in bench.curves.ties for name in no_load_line(direction)}
    curves = PARAMETERS.group("no-load line", "thrust curve", "torque curve")
    return tuple(name for name in curves if name not in known)


def _check_choice(chosen: tuple[str, ...], given: Collection[str], scale_known: bool) -> None:
    """Refuse a free parameter that no trial depends on; warn of free ones that the logs leave arbitrary."""
    if "rotor_inertia" not in {*chosen, *given}:
        notice(
            "inertia-of-another-motor",
            f"the rotor's inertia is neither measured nor free, so Table I's "
            f"{PARAMETERS['rotor_inertia'].nominal:g} kg·m² of another motor is used; state "
            "motor.rotor_inertia or name it in parameters.free",
        )
    silent = [name for name in chosen if name in PARAMETERS.group("thrust curve")]
    if silent:
        raise CampaignError(
            f"parameters.free names {', '.join(silent)}, on which neither torque nor speed depends; thrust "
            "comes from the static curves, so take it off the list"
        )
    scale = [name for name in CONSTANTS if name in chosen]
    if scale and "winding_resistance" in chosen and not scale_known:
        notice(
            "scale-free",
            f"{' and '.join(scale)} free with winding_resistance, and no log has the motor's current: "
            "torque and speed determine only k²/R, R/L and k·I_sat, which the result lists; the values "
            "themselves are arbitrary together",
        )


def motor_space(campaign: MotorCampaign, bench: Bench) -> SearchSpace:
    """Return what the dynamic fit frees: the campaign's, or R, L and k_d, and what else its logs need.

    R and L are not free where slow logs give R by the power that their steady levels lose.
    The rotor's inertia is free where it was not measured; the command delay always, one per log where there
    are several, and the torque sensor's delay and lag where a trial is a slow log, unless the campaign fixes
    them. k_d is free by default only where a log without propeller gives Ω_0: with Ω_0 from loaded points,
    (k²/R, k_d, Ω_0) → (k²/R + c, k_d − c, Ω_0 (k²/R)/(k²/R + c)) changes nothing as L → 0.

    CampaignError for an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a measured
    value, a parameter that neither torque nor speed depends on.
    """
    choices, fixed = campaign.parameters, campaign.parameters.fixed
    if not set(SATURATION) <= {*fixed, *bench.measured}:
        # Freeing the dead band together with R, L and the delay does not help: they hide in one another.
        for trial in bench.fitted:
            if trial.only_starts:
                notice(
                    "little-but-a-start",
                    "little but a start from rest, so R, L and the delay depend on a dead band that the "
                    "paper's Table I states of another motor; add steps between running speeds, or state "
                    "motor.saturation_current and motor.saturation_speed",
                    trial=trial.entry.name,
                )
    without = {"viscous_damping"} if bench.curves.ties else set()
    default = [name for name in FREE_DEFAULT if name not in without | {*bench.measured, *bench.stated}]
    needed = ["command_delay"]
    if any(not trial.log.fast for trial in bench.fitted):
        needed += ["torque_sensor_delay", "torque_sensor_lag"]
    if campaign.motor.rotor_inertia is None and choices.free is None:
        needed.append("rotor_inertia")
    wanted = default if choices.free is None else [*choices.free]
    wanted += [name for name in needed if name not in wanted]
    # A name that the campaign both frees and fixes stays in the list, to be refused.
    asked = set(choices.free or ())
    chosen = tuple(n for n in wanted if n not in SATURATION and (n not in fixed or n in asked))
    _check_choice(chosen, {*fixed, *bench.values}, bench.scale_known)
    # Bounds of the dead band belong to the second stage.
    bounds = {name: pair for name, pair in choices.bounds.items() if name not in SATURATION}
    choices = choices.model_copy(update={"free": chosen, "bounds": bounds})
    # A guess need not lie between the bounds of what is freed; a measurement must.
    values = {n: value for n, value in bench.values.items() if n not in chosen or n in bench.measured}
    table = parameters_of({**bench.values, **choices.fixed_values(PARAMETERS)})
    space = choices.search_space(table, FREE_DEFAULT, values)
    space = with_log_delays(space, bench.fitted, bench.banded)
    return space if campaign.fit.exact else _with_stated(space, campaign, bench)


def _with_stated(space: SearchSpace, campaign: MotorCampaign, bench: Bench) -> SearchSpace:
    """Return a space in which what was measured with an error moves, with a row for each.

    A range under `[parameters.measured]` is the error of a value that states none. Thrust stays, because no
    residual depends on it, and so does V_ref where the logs take it out again. The torque constant follows
    the back-EMF constant (`MotorProblem.complete`).

    The load cells of the static logs and of the trials have a factor each, because even one cell, mounted
    anew, is hardly the same to 0.1 %. Beside a curve of the trials' own levels their torque is the measure.
    """
    choices = campaign.parameters
    fixed, ranges = choices.fixed_values(PARAMETERS), choices.measured_ranges(PARAMETERS)
    stated = {}
    for name, value in {**bench.values, **fixed}.items():
        low, high = ranges.get(name, (0.0, 0.0))
        if not isinstance(value, Stated) or (value.assumed and high > low):
            value = Stated(value, (high - low) / np.sqrt(12.0))
        if value.error > 0 and name in space.fixed:
            stated[name] = value
    if not stated:
        return space
    stays = {*PARAMETERS.group("thrust curve")} | ({*bench.curves.parameters} - {*fixed})
    chosen, turning = {*space.names, *fixed}, {trial.entry.direction for trial in bench.fitted}
    own = [each for each in bench.measured_curves if not {*each.fit.parameters} & chosen]
    curves = [each for each in own if each.fit.direction in turning]
    if not (bench.volts and curves) or {"reference_voltage", *PARAMETERS.group("no-load line")} & chosen:
        stays.add("reference_voltage")
    if {*CONSTANTS} <= {*stated} and not {*CONSTANTS} & {*fixed}:
        stays.add("torque_constant")
    stated = {name: value for name, value in stated.items() if name not in stays}
    for curve in curves:
        stated |= {row.name: Stated(1.0, error) for row, error in zip(curve.rows, curve.errors, strict=True)}
    rows = [row for curve in curves for row in curve.rows]
    log, weighed = campaign.log, {each.fit.direction for each in own if each.fit.quantity == "torque"}
    if log.calibration_error > 0 and weighed & turning and {*bench.curves.ties} <= weighed:
        cells = LOAD_CELLS if turning <= weighed else LOAD_CELLS[:1]
        assumed = "" if "calibration_error" in log.model_fields_set else f"{100 * log.calibration_error:g} %"
        stated |= dict.fromkeys((row.name for row in cells), Stated(1.0, log.calibration_error, assumed))
        rows += cells
    return space.with_stated(stated, rows)
