"""`sysid validate` and `sysid cross-validate`: a fit against trials that it has not seen."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign, MotorCampaign, read_campaign
from sysid.errors import FitError, SysidWarning
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.store import read_fit
from sysid.gear import problem as gear
from sysid.gear.drops import PreparedDrop, prepare_drops
from sysid.gear.model import PARAMETERS, EventKind, simulate
from sysid.gear.problem import GearObjective, trial_results
from sysid.gear.resting_place import stopping
from sysid.gear.trust import TRUST_TOLERANCE, compared_noise
from sysid.motor import known_values as motor_bench
from sysid.motor.known_values import prepare_bench
from sysid.motor.objective import MotorObjective
from sysid.motor.problem import motor_trial_results
from sysid.motor.trust import ASSUMED_NOISE, MotorProblem, bench_floors, without_noise
from sysid.parallel import executor
from sysid.recording import file_sha256
from sysid.trust.assessment import linearize
from sysid.trust.documents import CROSS_VALIDATION, free_part, validation_part, write_part
from sysid.trust.influence import STANDS_OUT
from sysid.trust.problem import Problem, SpreadProblem, nrmse_of
from sysid.trust.resampling import leave_one_out
from sysid.trust.validation import LEAVES, RATIO, RATIO_EARLY, Judged, document, judge, reasons
from sysid.types import FloatArray
from sysid.workflows.predicted_rows import gear_rows, motor_rows
from sysid.workflows.reopen import OpenedFit, bench_problem, fit_folder, law_of, noise_floors, open_fit
from sysid.workflows.search import collected_warnings, naming, seen_from

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
    folder = fit_folder(folder)
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
    said = {
        "file": campaign_path.name,
        "sha256": file_sha256(campaign_path),
        "from_fit_folder": seen_from(folder, campaign_path),
    }
    out = {
        "campaign": said,
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
    doubts = [*doubts, *_unlike_the_others(judged, result.kind)]
    out["warnings"] = doubts
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
    part = free_part(folder, validation_part(campaign.name), said)
    write_part(folder, part, out, arrays, fit=result.name, kind=result.kind)
    return out


def _unlike_the_others(judged: list[Judged], kind: str) -> list[str]:
    """Return a sentence on every trial that is predicted far worse than the others are."""
    ratios = np.array([one.ratio for one in judged])
    if len(ratios) < 3 or not np.isfinite(ratios).all():
        return []
    usual = float(np.median(ratios))
    cause = "another supply or tare, or a misread unit, clock or log"
    if kind == "gear":
        cause = "a start beside a fork of the bounces, or a misread slope, surface or log"
    return [
        f"{one.name}: {one.ratio:.1f} × what noise alone costs where the trials have {usual:.1f} (median): "
        f"{cause}"
        for one in judged
        if one.ratio > max(1.0, STANDS_OUT * usual)
    ]


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


def _gear(
    result: FitResult, campaign: GearCampaign, path: Path, threads: int | None
) -> tuple[list[Judged], list[dict[str, Any]], list[TrialResult]]:
    drops = prepare_drops(campaign, path)
    names = unseen(result, {drop.name: str(drop.provenance["sha256"]) for drop in drops}, path)
    chosen = tuple(drop for drop in drops if drop.name in names)
    rows = gear_rows(result, campaign)
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
    base = np.array([space.fixed.get(name, row.nominal) for name, row in space.table.items()])
    rows = motor_rows(result, campaign, bench, space, base)
    index = {record.name: i for i, record in enumerate(result.parameters)}
    # Delays of logs that the fit has not seen: its mean delay; the dead band was fitted as well.
    for name in own:
        source = space.table[name].common_name
        if source in ("command_delay", "saturation_current", "saturation_speed") and source in index:
            rows[:, own.index(name)] = result.values[:, index[source]]
    rows = objective.complete(rows)
    trials = motor_trial_results(objective, rows)
    problem = bench_problem(campaign, bench, objective)
    _say_assumed(problem)
    floors = np.full((len(trials), len(result.channels)), np.nan)
    for block, level in zip(problem.blocks, bench_floors(problem, rows[0]), strict=True):
        floors[block.trial, block.channel] = level
    judged = [
        judge(
            trial.name, trial.time, trial.measured, trial.valid, trial.simulated,
            spread=objective.cost.denominators[t], noise=floors[t] * objective.cost.denominators[t],
            weights=objective.cost.weights, channels=result.channels, zero=float(trial.time[0]),
        )
        for t, trial in enumerate(trials)
    ]  # fmt: skip
    return judged, [{"slope_deg": None, "stop": None} for _ in judged], list(trials)


def _say_assumed(problem: MotorProblem) -> None:
    silent = without_noise(problem)
    if silent:
        warnings.warn(
            f"{', '.join(silent)}: the log shows no noise at its resolution, so {100 * ASSUMED_NOISE:g} % "
            "NRMSE is taken for it: what follows judges it no finer than that",
            SysidWarning,
            stacklevel=2,
        )


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
        if isinstance(opened.problem, MotorProblem):
            _say_assumed(opened.problem)
        if len(opened.problem.trials) < 2:
            raise FitError(f"{folder}: a single trial was fitted; leaving it out leaves nothing")
        with executor(dask, 2) as where:
            problem: Problem = SpreadProblem(opened.problem, where)
            linear = linearize(problem, result.cube[0])
            tell(f"{len(problem.trials)} fits, each without one trial")
            found = leave_one_out(
                problem, linear.point, linear.scale, linear.jacobian.steps, linear.tolerance
            )  # fmt: skip
            values, _ = problem.residuals(found.points)
    floors = noise_floors(opened, linear.point)
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
        floor = float(weight @ floors[mine])
        nrmse = np.array([float(weight @ levels[t, mine])])
        early, until = _left_out_early(opened, t, found.points[t], problem, values[t], floors)
        judged.append(Judged(name, nrmse, by_channel, floor, early, until, None))
    why = reasons(judged)
    out = {
        "campaign": {"file": opened.path.name, "sha256": file_sha256(opened.path)},
        "flagged": bool(why),
        "reasons": list(why),
        "limits": LIMITS,
        "nrmse": float(np.mean([one.nrmse[0] for one in judged])),
        "nrmse_fitted": float(result.nrmse[0]),
        "ratio": float(np.mean([one.ratio for one in judged])),
        "ratio_third_contact": float(np.mean([one.early_ratio for one in judged])),
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


def _left_out_early(
    opened: OpenedFit, t: int, point: FloatArray, problem: Problem, values: FloatArray, floors: FloatArray
) -> tuple[tuple[float, float] | None, float | None]:
    """Return (NRMSE, floor) of a drop up to its third touchdown, and when that is [s]; None of a bench."""
    if not isinstance(opened.campaign, GearCampaign):
        return None, None
    drop = next(one for one in opened.drops if one.name == problem.trials[t])
    row = opened.space.full(point[None])[0][: len(PARAMETERS)]
    contacts = touchdowns(drop, row, opened.campaign)
    end = float(contacts[2]) if len(contacts) > 2 else float(drop.time[-1])
    first = drop.time <= end
    mine = [b for b, block in enumerate(problem.blocks) if block.trial == t]
    weight = np.array([problem.blocks[b].weight for b in mine])
    weight /= weight.sum()
    # A sample that does not count has the residual 0 and is no sample.
    parts = [values[problem.blocks[b].start : problem.blocks[b].stop][first] for b in mine]
    count = [max(1, int(np.count_nonzero(part))) for part in parts]
    rms = np.sqrt(np.array([float(np.sum(part**2)) for part in parts]) / count)
    return (float(weight @ rms), float(weight @ floors[mine])), end - drop.touchdown
