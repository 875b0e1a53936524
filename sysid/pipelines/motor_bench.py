"""A motor campaign after its logs were read: trials, static curves and the values that they fix."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.errors import CampaignError, SysidWarning
from sysid.motor.model import FREE_DEFAULT, PARAMETERS
from sysid.parameters import SearchSpace
from sysid.pipelines.bench_curves import StaticCurves, static_curves
from sysid.pipelines.bench_logs import BenchLog, PreparedTrial, bench_log, prepare_trial
from sysid.units import parse_quantity

# Full duty of an unloaded motor turns at V_ref/k_v; steady loaded speed extrapolated to u = 1 falls short of
# that by about this factor. Only a start for motors of unknown Kv: no result depends on it but the scale.
_LOADED_SHARE = 0.8


# Fitted to reversals after everything else, never with it.
SATURATION = ("saturation_current", "saturation_speed")


@dataclass(frozen=True, eq=False)
class Bench:
    """A motor campaign after its logs were read.

    Parameters
    ----------
    trials : tuple of PreparedTrial
    curves : StaticCurves
    values : dict
        Parameters that the campaign or its static logs fix, by name [SI].
    measured : tuple of str
        Those of them that were measured.
    """

    trials: tuple[PreparedTrial, ...]
    curves: StaticCurves
    values: dict[str, float]
    measured: tuple[str, ...]

    @property
    def fitted(self) -> tuple[PreparedTrial, ...]:
        """Trials of the dynamic fit: use "fit", and no reversal."""
        return tuple(t for t in self.trials if in_search(t))


def in_search(trial: PreparedTrial) -> bool:
    """Return whether the dynamic fit sees a trial; reversals come after it, as in the paper."""
    return trial.entry.use == "fit" and trial.entry.direction != "reversal"


def prepare_bench(campaign: MotorCampaign, path: str | Path) -> Bench:
    """Read every log of a campaign, fit the static curves and prepare the trials.

    Raises
    ------
    SysidError
        For the first log that cannot be used, or a campaign that has nothing to fit.
    """
    logs = [bench_log(campaign, path, entry) for entry in campaign.trials]
    fitted = [
        log
        for log, entry in zip(logs, campaign.trials, strict=True)
        if entry.use == "fit" and entry.direction != "reversal"
    ]
    if not fitted:
        raise CampaignError(
            "no forward or reverse trial has use = 'fit'; reversals alone cannot serve, because the dead "
            "band would hide in R and L"
        )
    reference = campaign.motor.reference_voltage or _median_supply(fitted)
    curves = static_curves(campaign, path, fitted, reference)
    values, measured = _known_values(campaign, curves, reference)
    trials = tuple(
        prepare_trial(campaign, entry, log, reference)
        for entry, log in zip(campaign.trials, logs, strict=True)
    )
    return Bench(trials, curves, values, measured)


def _median_supply(logs: list[BenchLog]) -> float:
    volts = [log.channels["voltage"][1] for log in logs if "voltage" in log.channels]
    return float(np.median(np.concatenate(volts))) if volts else PARAMETERS.nominal["reference_voltage"]


def _known_values(
    campaign: MotorCampaign, curves: StaticCurves, reference: float
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the values that the campaign states or its static logs give, and which were measured."""
    motor = campaign.motor
    values = {**curves.parameters, "reference_voltage": reference}
    measured = [*curves.parameters]
    if motor.kv is not None:
        values |= {"back_emf_constant": 1.0 / motor.kv, "torque_constant": 1.0 / motor.kv}
    elif curves.ties:
        top = max(float(np.sum(tie.speed)) for tie in curves.ties.values())
        constant = _LOADED_SHARE * reference / top
        values |= {"back_emf_constant": constant, "torque_constant": constant}
    if motor.kv is None and not {"back_emf_constant", "torque_constant"} <= set(campaign.parameters.fixed):
        warnings.warn(
            "no Kv in the campaign: R, L and I_sat rest on a guessed motor constant of "
            f"{values.get('torque_constant', PARAMETERS.nominal['torque_constant']):.4g} N·m/A; torque and "
            "speed fix only k²/R, R/L and k·I_sat, which the result lists",
            SysidWarning,
            stacklevel=2,
        )
    if motor.rotor_inertia is not None:
        values["rotor_inertia"] = motor.rotor_inertia
        measured.append("rotor_inertia")
    for name, text, unit in (
        ("saturation_current", motor.saturation_current, "A"),
        ("saturation_speed", motor.saturation_speed, "rad/s"),
    ):
        if text is not None:
            values[name] = parse_quantity(text, unit)
            measured.append(name)
    return values, tuple(measured)


def search_space(campaign: MotorCampaign, bench: Bench) -> SearchSpace:
    """Return what the dynamic fit frees: the campaign's, or R, L and k_d, and what its logs need beside them.

    The rotor's inertia is free where it was not measured; the command delay always, and the torque sensor's
    delay and lag where a trial is a slow log, unless the campaign fixes them. k_d is free by default only
    where a log without propeller gives Ω_0: with Ω_0 from loaded points,
    (k²/R, k_d, Ω_0) → (k²/R + c, k_d − c, Ω_0 (k²/R)/(k²/R + c)) changes nothing as L → 0.

    Raises
    ------
    CampaignError
        For an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a measured value.
    """
    needed = ["command_delay"]
    if any(not trial.log.fast for trial in bench.fitted):
        needed += ["torque_sensor_delay", "torque_sensor_lag"]
    choices = campaign.parameters
    default = [name for name in FREE_DEFAULT if name != "viscous_damping" or not bench.curves.ties]
    free = list(default if choices.free is None else choices.free)
    if campaign.motor.rotor_inertia is None and choices.free is None:
        needed.append("rotor_inertia")
    free += [name for name in needed if name not in free]
    free = [name for name in free if name not in SATURATION]
    # A name that the campaign both frees and fixes stays in the list, to be refused.
    asked = set(choices.free or ())
    chosen = tuple(name for name in free if name not in choices.fixed or name in asked)
    choices = choices.model_copy(update={"free": chosen})
    values = {name: value for name, value in bench.values.items() if name not in chosen}
    return choices.search_space(PARAMETERS, FREE_DEFAULT, values)
