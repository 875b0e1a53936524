"""`sysid validate` and `sysid cross-validate`: a fit against trials that it has not seen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import GearCampaign, MotorCampaign, read_campaign
from sysid.errors import FitError
from sysid.executor import executor
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.store import read_fit
from sysid.gear.model import PARAMETERS, EventKind, parameters_on, simulate
from sysid.pipelines import gear, motor_bench
from sysid.pipelines.drops import PreparedDrop, prepare_drops
from sysid.pipelines.gear import GearObjective, trial_results
from sysid.pipelines.motor import motor_trial_results
from sysid.pipelines.motor_bench import prepare_bench
from sysid.pipelines.motor_objective import MotorObjective
from sysid.pipelines.search import collected_warnings, naming
from sysid.pipelines.stopping_place import stopping
from sysid.pipelines.trust_gear import TRUST_TOLERANCE, compared_noise
from sysid.pipelines.trust_setup import law_of, open_fit
from sysid.recording import file_sha256
from sysid.trust.assessment import linearize
from sysid.trust.problem import SpreadProblem, nrmse_of
from sysid.trust.resampling import leave_one_out
from sysid.trust.store import CROSS_VALIDATION, validation_part, write_part
from sysid.trust.validation import LEAVES, RATIO, RATIO_EARLY, Judged, document, judge, reasons

FloatArray = NDArray[np.float64]

LIMITS = {"ratio": RATIO, "ratio_third_contact": RATIO_EARLY, "leaves": LEAVES}
# Touchdowns of one foot closer than this count as one [s].
_ONE_TOUCHDOWN = 5e-3


def validate_fit(
    folder: Path,
    campaign_path: Path,
    *,
    threads: int | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Score a fit on the trials of a campaign that it was not fitted to, and store that in its folder.

    Parameters
    ----------
    folder : Path
        Fit folder.
    campaign_path : Path
        Any campaign of the same kind; of the fit's own, the trials of use "validate".
    threads : int, optional
    say : callable, optional

    Raises
    ------
    SysidError
        When nothing is left to validate with, or an input cannot be used; nothing has been written then.
    """
    tell = say or (lambda sentence: None)
    folder = folder.parent if folder.name == "fit.h5" else folder
    result = read_fit(folder)
    with naming(campaign_path), collected_warnings(None) as doubts:
        campaign = read_campaign(campaign_path, result.kind)
        if isinstance(campaign, GearCampaign):
            law = str(result.settings["surface"])
            judged, extra, trials = _gear(result, law_of(campaign, law), campaign_path, threads)
        else:
            assert isinstance(campaign, MotorCampaign)
            judged, extra, trials = _motor(result, campaign, campaign_path, threads)
    why = reasons(judged)
    out = {
        "campaign": {"file": campaign_path.name, "sha256": file_sha256(campaign_path)},
        "flagged": bool(why),
        "reasons": list(why),
        "limits": LIMITS,
        "nrmse": float(np.mean([one.nrmse[0] for one in judged])),
        "nrmse_fitted": float(result.nrmse[0]),
        "ratio": float(np.mean([one.ratio for one in judged])),
        "ratio_third_contact": float(np.mean([one.early_ratio for one in judged])),
        "trials": [
            {**document(one, result.channels), **more} for one, more in zip(judged, extra, strict=True)
        ],
        "warnings": doubts,
    }
    for sentence in (*doubts, *why):
        tell(f"warning: {sentence}")
    units = ", ".join(result.channel_units)
    arrays: dict[str, tuple[Any, str, str]] = {}
    for number, trial in enumerate(trials, start=1):
        root = f"trials/{number}"
        arrays[f"{root}/time"] = (trial.time, "sample", "s")
        arrays[f"{root}/measured"] = (trial.measured, "sample, channel", units)
        arrays[f"{root}/valid"] = (trial.valid, "sample, channel", "1")
        arrays[f"{root}/simulated"] = (trial.simulated, "set, sample, channel", units)
    write_part(
        folder, validation_part(campaign.name), out, arrays, fit=result.name, kind=result.kind
    )  # fmt: skip
    return out


def unseen(result: FitResult, hashes: dict[str, str], path: Path) -> list[str]:
    """Return the names of the trials whose logs the fit has not seen.

    Raises
    ------
    FitError
        When there are none.
    """
    fitted = {trial.name for trial in result.trials if trial.use == "fit"}
    logs = result.provenance.get("logs", {})
    seen = {str(one.get("sha256")) for name, one in logs.items() if name in fitted}
    left = [name for name, digest in hashes.items() if digest not in seen]
    if not left:
        raise FitError(
            f"{path}: the fit was made from every trial in it, so they validate nothing; hold trials back "
            f"with "
            "use = 'validate', or ask for sysid cross-validate"
        )
    return left


def fit_rows(result: FitResult, names: tuple[str, ...], base: FloatArray) -> FloatArray:
    """Return rows (S, n) of a campaign's table [SI]: the fit's free parameters, all else the campaign's."""
    rows = np.repeat(base[None], len(result.nrmse), axis=0)
    for i, record in enumerate(result.parameters):
        if record.status == "free" and record.name in names:
            rows[:, names.index(record.name)] = result.values[:, i]
    return rows


def campaign_row(campaign: GearCampaign) -> FloatArray:
    """Return the row (n_par,) of the gear's table that a campaign states [SI]; else the law's defaults."""
    space = gear.search_space(campaign)
    known = {**parameters_on(campaign.surface.law).nominal, **gear.measured_values(campaign), **space.fixed}
    return np.array([known[name] for name in PARAMETERS])


def _gear(
    result: FitResult, campaign: GearCampaign, path: Path, threads: int | None
) -> tuple[list[Judged], list[dict[str, Any]], list[TrialResult]]:
    drops = prepare_drops(campaign, path)
    names = unseen(result, {drop.name: str(drop.provenance["sha256"]) for drop in drops}, path)
    chosen = tuple(drop for drop in drops if drop.name in names)
    rows = fit_rows(result, tuple(PARAMETERS), campaign_row(campaign))
    objective = GearObjective.build(campaign, gear.search_space(campaign), chosen, threads, TRUST_TOLERANCE)
    trials, _ = trial_results(objective, rows)
    weights = objective.cost.weights
    judged, extra = [], []
    for t, (drop, trial) in enumerate(zip(chosen, trials, strict=True)):
        judged.append(
            judge(
                drop.name, trial.time, trial.measured, trial.valid, trial.simulated,
                spread=objective.cost.denominators[t], noise=compared_noise(drop), weights=weights,
                channels=result.channels, zero=drop.touchdown, contacts=touchdowns(drop, rows[0], campaign),
            )
        )  # fmt: skip
        extra.append({"slope_deg": float(np.degrees(drop.slope)), "stop": stopping(objective, rows, drop)})
    return judged, extra, list(trials)


def touchdowns(drop: PreparedDrop, row: FloatArray, campaign: GearCampaign) -> FloatArray:
    """Return when feet touch in a set's prediction, on the drop's clock [s]; within 5 ms they touch once."""
    run = simulate(
        row, drop.slope, drop.initial_state, drop.simulated_time,
        surface=campaign.surface.law, tolerance=TRUST_TOLERANCE,
    )  # fmt: skip
    out: list[float] = []
    last: dict[str, float] = {}
    for event in run.events:
        if event.kind is EventKind.TOUCHDOWN:
            if event.time - last.get(event.foot, -1.0) > _ONE_TOUCHDOWN:
                out.append(event.time)
            last[event.foot] = event.time
    return drop.time[0] + np.array(out)


def _motor(
    result: FitResult, campaign: MotorCampaign, path: Path, threads: int | None
) -> tuple[list[Judged], list[dict[str, Any]], list[TrialResult]]:
    bench = prepare_bench(campaign, path)
    names = unseen(result, {trial.entry.name: trial.hashes.split()[0] for trial in bench.trials}, path)
    chosen = tuple(trial for trial in bench.trials if trial.entry.name in names)
    space = motor_bench.search_space(campaign, bench)
    objective = MotorObjective.build(campaign, space, bench, chosen, threads)
    own = tuple(space.table)
    base = space.full(np.full((1, len(space.free)), 0.5))[0]
    rows = fit_rows(result, own, base)
    index = {record.name: i for i, record in enumerate(result.parameters)}
    # Delays of logs that the fit has not seen: its mean delay; the dead band was fitted as well.
    for name in own:
        source = "command_delay" if name.startswith("command_delay") else name
        if source in ("command_delay", "saturation_current", "saturation_speed") and source in index:
            rows[:, own.index(name)] = result.values[:, index[source]]
    rows = objective.complete(rows)
    trials = motor_trial_results(objective, rows)
    floor = _fitted_levels(result)
    judged = [
        judge(
            trial.name, trial.time, trial.measured, trial.valid, trial.simulated,
            spread=objective.cost.denominators[t], noise=floor * objective.cost.denominators[t],
            weights=objective.cost.weights, channels=result.channels, zero=float(trial.time[0]),
        )
        for t, trial in enumerate(trials)
    ]  # fmt: skip
    return judged, [{"slope_deg": None, "stop": None} for _ in judged], list(trials)


def _fitted_levels(result: FitResult) -> FloatArray:
    """Return the mean NRMSE of the fitted trials by channel: the floor where the noise is not known."""
    return np.mean([trial.nrmse[0] for trial in result.trials if trial.use == "fit"], axis=0)


def cross_validate(
    folder: Path,
    campaign: Path | None = None,
    *,
    threads: int | None = None,
    dask: str | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Leave out one fitted trial after the other, fit the rest anew from the best set, predict the one left
    out.

    Raises
    ------
    FitError
        When fewer than two trials were fitted.
    """
    tell = say or (lambda sentence: None)
    with collected_warnings(None) as doubts:
        opened = open_fit(folder, campaign, 1 if dask else threads)
        result = opened.result
        if len(opened.problem.trials) < 2:
            raise FitError(f"{folder}: a single trial was fitted; leaving it out leaves nothing")
        with executor(dask, 2) as where:
            problem = SpreadProblem(opened.problem, where)
            linear = linearize(problem, result.cube[0])
            tell(f"{len(problem.trials)} fits, each without one trial")
            found = leave_one_out(
                problem, linear.point, linear.scale, linear.jacobian.steps, linear.tolerance
            )  # fmt: skip
            values, _ = problem.residuals(found.points)
    levels = nrmse_of(problem.blocks, values)
    decoded = opened.space.decode(found.points)
    judged: list[Judged] = []
    for t, name in enumerate(problem.trials):
        mine = [b for b, block in enumerate(problem.blocks) if block.trial == t]
        weight = np.array([problem.blocks[b].weight for b in mine])
        weight /= weight.sum()
        by_channel = np.full(len(result.channels), np.nan)
        for b in mine:
            by_channel[problem.blocks[b].channel] = levels[t, b]
        noise = np.array([problem.blocks[b].noise for b in mine])
        fitted = np.array([linear.levels[b] for b in mine])
        floor = float(weight @ np.where(np.isfinite(noise), noise, fitted))
        nrmse = np.array([float(weight @ levels[t, mine])])
        judged.append(Judged(name, nrmse, by_channel, floor, None, None, None))
    why = reasons(judged)
    out = {
        "campaign": {"file": opened.path.name, "sha256": file_sha256(opened.path)},
        "flagged": bool(why),
        "reasons": list(why),
        "limits": LIMITS,
        "nrmse": float(np.mean([one.nrmse[0] for one in judged])),
        "nrmse_fitted": float(result.nrmse[0]),
        "ratio": float(np.mean([one.ratio for one in judged])),
        "trials": [
            {
                **document(one, result.channels),
                "refit": dict(zip(opened.space.names, decoded[t].tolist(), strict=True)),
            }
            for t, one in enumerate(judged)
        ],
        "warnings": doubts,
    }
    for sentence in (*doubts, *why):
        tell(f"warning: {sentence}")
    arrays = {"values": (decoded, "trial left out, free parameter", "SI")}
    write_part(opened.folder, CROSS_VALIDATION, out, arrays, fit=result.name, kind=result.kind)
    return out
