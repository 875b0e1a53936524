"""What follows the search of a motor fit: dead band, ladder, profile, and what is said about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.fit.result import RankedSets
from sysid.fit.stopping import CutReason, CutShort
from sysid.motor.dead_band import (
    SaturationFit,
    edges_that_serve,
    fit_saturation,
    named,
    reversal_delays,
    with_saturation,
)
from sysid.motor.inertia import spike_inertia
from sysid.motor.known_values import CONSTANTS, SATURATION, Bench, untested_rows
from sysid.motor.ladder import climb, ladder_sentences
from sysid.motor.log_delays import averaged, delay_name
from sysid.motor.model import PARAMETERS, unpack
from sysid.motor.objective import MotorObjective
from sysid.motor.profile import profile
from sysid.motor.static_curves import CurveFit
from sysid.parameter_sets import COMBINATIONS, NOT_ALONE
from sysid.parameters import SearchSpace
from sysid.types import FloatArray
from sysid.workflows.fit import FitWalk
from sysid.workflows.search import Search

_INDEX = {name: i for i, name in enumerate(PARAMETERS)}
# A held-out log's own delay is looked for in these steps [s], so many to either side.
_DELAY_STEPS, _DELAY_REACH = (4e-3, 4e-4, 1e-4), 20
_LADDER, _PROFILES, _PROFILED = "ladder", "profiles", "viscous_damping"
_WHY: dict[CutReason, str] = {
    "interrupted": "the fit was interrupted",
    "time": "the time limit ended the fit",
}


@dataclass(frozen=True, eq=False)
class After:
    """What follows the search.

    Parameters
    ----------
    sets : RankedSets
        Ranked anew by `nrmse`.
    rows : (S, n_table) array
        Sets with the dead band and the delays of logs [SI].
    nrmse : (S,) array
        Of the final values over the fitted forward and reverse trials, starts from rest included [1].
    saturation : SaturationFit, optional
    settings : dict
        For the result.
    warnings : tuple of str
    """

    sets: RankedSets
    rows: FloatArray
    nrmse: FloatArray
    saturation: SaturationFit | None
    settings: dict[str, Any]
    warnings: tuple[str, ...]


def after_the_search(
    campaign: MotorCampaign,
    bench: Bench,
    objective: MotorObjective,
    sets: RankedSets,
    found: Search,
    walk: FitWalk,
) -> After:
    """Fit the dead band, score the final sets, climb the ladder, walk the profile, say what is doubtful.

    Where the fit is cut short, by now or in one of these steps, what is missing is said and left to
    ``--resume``, and `found` is marked as cut.
    """
    if found.cut is None:
        try:
            return _all_that_follows(campaign, bench, objective, sets, found, walk)
        except CutShort as cut:
            found.cut = cut.reason
    space = objective.space
    rows = averaged(space, objective.complete(sets.values))
    whole = MotorObjective.build(campaign, space, bench, bench.fitted, objective.threads)
    why = _WHY[found.cut]
    out: dict[str, Any] = {"saturation": {"stage": "not fitted", "why": why}}
    sets, rows, nrmse, _ = _ranked(sets, rows, None, whole)
    unfinished = f"{why}: {_missing(space, out)}; continue it with --resume"
    walk.tell(f"warning: {unfinished}")
    if not bench.scale_known:
        out |= _scale_free(set(SATURATION) <= {*bench.measured, *campaign.parameters.fixed})
    return After(sets, rows, nrmse, None, out, (unfinished,))


def _all_that_follows(
    campaign: MotorCampaign,
    bench: Bench,
    objective: MotorObjective,
    sets: RankedSets,
    found: Search,
    walk: FitWalk,
) -> After:
    """Take every step that follows a search that was not cut short; the last ones may still be.

    Raises
    ------
    CutShort
        When the fit must end before the dead band was fitted.
    """
    threads, space, settings, tell = objective.threads, objective.space, walk.settings, walk.tell
    go_on = walk.deadline.check
    rows = averaged(space, objective.complete(sets.values))
    whole = MotorObjective.build(campaign, space, bench, bench.fitted, threads)
    warned: list[str] = []
    saturation = fit_saturation(campaign, bench, space.table, rows, settings, sets.seed, threads, go_on)
    rows = with_saturation(space.table, rows, saturation)
    sets, rows, nrmse, saturation = _ranked(sets, rows, saturation, whole)
    best = named(space.table, rows[0])
    given = set(SATURATION) <= {*bench.measured, *campaign.parameters.fixed}
    out: dict[str, Any] = {
        "reversal delays": reversal_delays(campaign, bench, best),
        "command delays": log_delays(campaign, bench, whole, rows[0]),
    }
    stage, doubts = _about_saturation(bench, saturation, best, given, tell)
    if saturation is not None:
        edges = edges_that_serve(campaign, bench, space.table, rows[0], saturation, threads)
        stage["saturation_speed that serves as well [rad/s]"] = edges
        if edges is not None:
            doubts.append(
                f"{', '.join(saturation.trials)} do not fix saturation_speed: from {edges[0]:.2g} to "
                f"{edges[1]:.2g} rad/s, with the saturation_current that fits best beside each, the NRMSE is "
                "within 1 % of the lowest; its digits mean nothing"
            )
    out["saturation"] = stage
    warned += doubts
    out["static curves of the best set"] = tied_curves(bench, objective, best)
    try:
        climbed = climb(
            campaign, bench, space, best, saturation is not None or given, settings, sets.seed[0], threads,
            go_on,
        )  # fmt: skip
        below = (None, *climbed[:-1])
        out[_LADDER] = [rung.document(other) for rung, other in zip(climbed, below, strict=True)]
        warned += ladder_sentences(out[_LADDER])
        if _PROFILED in space.names:
            # Of the torque curve's linear coefficient, which stands beside k_d in the equation of the rotor.
            errors = [fit.standard_errors[1] for fit in bench.curves.fits if fit.quantity == "torque"]
            damping = profile(objective, _PROFILED, sets.cube[0], sets.seed[0], max(errors), go_on)
            out[_PROFILES] = {damping.name: damping.document()}
            warned += [] if damping.sentence is None else [damping.sentence]
    except CutShort as cut:
        found.cut = cut.reason
        warned.append(f"{_WHY[cut.reason]}: {_missing(space, out)}; continue it with --resume")
    spikes = spike_inertia(
        campaign, [trial.log for trial in bench.fitted], unpack(rows[0, : len(PARAMETERS)])
    )
    out["rotor inertia from torque spikes"] = spikes.document()
    warned += [] if spikes.sentence is None else [spikes.sentence]
    if not bench.scale_known:
        out |= _scale_free(saturation is not None or given)
    for sentence in warned:
        tell(f"warning: {sentence}")
    return After(sets, rows, nrmse, saturation, out, tuple(warned))


def _missing(space: SearchSpace, out: Mapping[str, Any]) -> str:
    """Return what a fit that was cut short has not looked at."""
    missing = []
    if out["saturation"].get("why") in _WHY.values():
        missing.append("the dead band was not fitted")
    if _LADDER not in out:
        missing.append("the ladder of simpler models was not climbed")
    if _PROFILED in space.names and _PROFILES not in out:
        missing.append(f"{_PROFILED} was not profiled, so its digits may mean nothing")
    return "; ".join(missing)


def _scale_free(banded: bool) -> dict[str, Any]:
    """Return which numbers of a motor of unknown scale are not fixed alone, and what they fix together."""
    alone = ["winding_resistance", "winding_inductance", *SATURATION[:1], *CONSTANTS]
    together = ["k2_over_R", "R_over_L", "electromechanical_time_constant"]
    return {NOT_ALONE: alone, COMBINATIONS: together[:2] + ["k_I_sat"] * banded + together[2:]}


def _ranked(
    sets: RankedSets, rows: FloatArray, saturation: SaturationFit | None, whole: MotorObjective
) -> tuple[RankedSets, FloatArray, FloatArray, SaturationFit | None]:
    """Rank the sets by the NRMSE of their final values, which the search did not see."""
    nrmse = whole.cost.mean(whole.score(rows)[0])
    order = np.argsort(nrmse, kind="stable")
    ranked = RankedSets(
        tuple(sets.run[i] for i in order), tuple(sets.seed[i] for i in order), sets.cube[order],
        sets.cost[order], sets.values[order], sets.at_bound[order],
    )  # fmt: skip
    if saturation is not None:
        per_set = ("values", "at_bound", "nrmse", "without")
        saturation = replace(saturation, **{name: getattr(saturation, name)[order] for name in per_set})
    return ranked, rows[order], nrmse[order], saturation


def _about_saturation(
    bench: Bench,
    saturation: SaturationFit | None,
    best: Mapping[str, float],
    given: bool,
    tell: Callable[[str], None],
) -> tuple[dict[str, Any], list[str]]:
    """Return what the result states of the second stage, and what is doubtful about it."""
    if saturation is not None:
        tell(
            f"dead band from {saturation.shown_by} of {', '.join(saturation.trials)}: I_sat "
            f"{best['saturation_current']:.3g} A below {best['saturation_speed']:.3g} rad/s; NRMSE there "
            f"{100 * saturation.without[0]:.2f} % without, {100 * saturation.nrmse[0]:.2f} % with it"
        )
        doubts = []
        if saturation.shown_by != "reversals":
            doubts.append(
                "the dead band rests on starts from rest alone: a controller that takes another way through "
                "a reversal is not described by it; add a reversal trial of use = 'fit'"
            )
        return saturation.document(), doubts
    if given:
        return {"stage": "not fitted", "why": "given by the campaign"}, []
    why = "no trial of use = 'fit' shows them, by a reversal or by a start from rest inside its window"
    return {"stage": "not fitted", "why": why}, [
        f"saturation_current and saturation_speed are not fitted ({why}); they keep Table I's "
        f"{best['saturation_current']:g} A and {best['saturation_speed']:g} rad/s"
    ]


def log_delays(
    campaign: MotorCampaign, bench: Bench, objective: MotorObjective, row: FloatArray
) -> list[dict[str, Any]]:
    """Return the command delay of every log: as fitted, or as a log shows it that no stage has seen.

    The second kind is looked for on the log itself with all else held; its scores do not use it.
    """
    space = objective.space
    values = named(space.table, row)
    seen = {trial.entry.log for trial in (*bench.fitted, *bench.banded)}
    column = _INDEX["command_delay"]
    out: list[dict[str, Any]] = []
    for log in dict.fromkeys(trial.entry.log for trial in bench.trials):
        used = values.get(delay_name(log), values["command_delay"])
        fact: dict[str, Any] = {"log": log, "delay [s]": used, "estimated": log in seen}
        if log not in seen:
            trials = tuple(trial for trial in bench.trials if trial.entry.log == log)
            alone = MotorObjective.build(campaign, space, bench, trials, objective.threads)
            best, costs = used, np.zeros(1)
            for step in _DELAY_STEPS:
                around = best + step * np.arange(-_DELAY_REACH, _DELAY_REACH + 1)
                around = np.concatenate([[used], np.clip(around, 0.0, PARAMETERS["command_delay"].upper)])
                rows = np.repeat(row[None], around.size, axis=0)
                rows[:, column] = around
                costs = alone.cost.mean(alone.score(rows)[0])
                best = float(around[np.argmin(costs)])
            fact |= {
                "own delay [s]": best,
                "nrmse": float(costs[0]),
                "nrmse with its own delay": float(costs.min()),
            }
        out.append(fact)
    return out


def tied_curves(bench: Bench, objective: MotorObjective, best: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the no-load lines that were fitted together with R, as of the best set."""
    drop = best["winding_resistance"] / (best["torque_constant"] * best["back_emf_constant"])
    fits = [
        tie.fit(d, drop, best["viscous_damping"])
        for d, tie in bench.curves.ties.items()
        if d in objective.ties
    ]
    return [fit.document() for fit in fits]


def curve_sentence(fit: CurveFit) -> str:
    """Return a static curve in a sentence: coefficients, standard errors, how well the points lie on it."""
    names = ("a", "b") if fit.quantity == "no_load" else ("c2", "c1")
    numbers = ", ".join(
        f"{name} = {value:.5g} ± {error:.2g} {unit}"
        for name, value, error, unit in zip(
            names, fit.coefficients, fit.standard_errors, fit.units, strict=True
        )
    )
    outliers = f", {fit.outliers} of them outliers" if fit.outliers else ""
    quality = f"R² {fit.r_squared:.5f} over {fit.points} points{outliers}"
    return f"{fit.quantity}, {fit.direction}: {numbers}; {quality}"


def say_what_is_fitted(
    campaign: MotorCampaign, bench: Bench, space: SearchSpace, tell: Callable[[str], None]
) -> None:
    """Say what is free and what was found out about the logs, before the search."""
    scored = len(bench.trials) - len(bench.fitted)
    tell(f"{len(bench.fitted)} trials to fit, {scored} to validate; free: {', '.join(space.names)}")
    for fit in bench.curves.fits:
        tell(curve_sentence(fit))
    for trial in bench.trials:
        tares = ", ".join(
            f"{name} {1e3 * tare.value:.3g} m{unit}"
            for name, unit in (("torque", "N·m"), ("thrust", "N"))
            if (tare := trial.log.tares.get(name)) is not None and tare.source != "assumed"
        )
        if tares:
            source = trial.log.tares["torque" if "torque" in trial.log.tares else "thrust"].source
            tell(f"trial {trial.entry.name}: tare from its {source}: {tares}")
        signs = (("torque", trial.log.torque_sign), ("thrust", trial.log.thrust_sign))
        turned = " and ".join(name for name, sign in signs if sign < 0 and name in trial.log.channels)
        if turned:
            tell(f"trial {trial.entry.name}: sign of {turned} turned")
        lost = sum(end - start for start, end in trial.log.doubtful)
        if lost:
            tell(
                f"trial {trial.entry.name}: {len(trial.log.doubtful)} stalls of the logger around commands, "
                f"{lost:.1f} s left out of the cost"
            )
    if bench.curves.ties and "viscous_damping" not in space.names:
        tell(
            "no log without propeller: the no-load speed follows R from loaded points, and k_d, which cannot "
            f"be told from k²/R then, stays at {space.fixed['viscous_damping']:.2g} N·m·s/rad"
        )
    if untested_rows(campaign, bench):
        tell("nothing was recorded in reverse: its curves and no-load speed are left out of the sets (NaN)")


def unresolved_inductance(bench: Bench, row: FloatArray) -> tuple[str, ...]:
    """Return a sentence where L/R of the best set is shorter than the logs can show."""
    rise = float(row[_INDEX["winding_inductance"]] / row[_INDEX["winding_resistance"]])
    # A rise within one step of the finest grid that any fitted log is compared on leaves no sample inside it.
    finest = min(float(np.median(np.diff(trial.target.time))) for trial in bench.fitted)
    if rise > finest:
        return ()
    return (
        f"L/R of the best set is {1e3 * rise:.3g} ms and the finest fitted log is compared every "
        f"{1e3 * finest:.3g} ms: the logs only say that L is small, not how small",
    )
