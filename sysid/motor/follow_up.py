"""What follows the search of a motor fit: dead band, ladder, profile, and what is noticed about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sysid.fit.problem import Course
from sysid.fit.result import RankedSets
from sysid.fit.stopping import CutReason, CutShort
from sysid.journal import notice, tell
from sysid.motor.dead_band import (
    SaturationFit,
    edges_that_serve,
    fit_saturation,
    named,
    reversal_delays,
    saturation_space,
)
from sysid.motor.inertia import spike_inertia
from sysid.motor.known_values import CONSTANTS, SATURATION, Bench, untested_rows
from sysid.motor.ladder import climb, ladder_sentences
from sysid.motor.log_delays import averaged, delay_name
from sysid.motor.model import PARAMETERS, unpack
from sysid.motor.problem import MotorProblem
from sysid.motor.profile import profile
from sysid.motor.static_curves import CurveFit
from sysid.parameter_sets import COMBINATIONS, NOT_ALONE
from sysid.parameters import SearchSpace
from sysid.types import FloatArray

_INDEX = PARAMETERS.index
# The delay of a held-out log is looked for in these steps [s], this number of steps to either side.
_DELAY_STEPS, _DELAY_REACH = (4e-3, 4e-4, 1e-4), 20
_LADDER, _PROFILES, _PROFILED = "ladder", "profiles", "viscous_damping"
_WHY: dict[CutReason, str] = {
    "interrupted": "the fit was interrupted",
    "time": "the time limit ended the fit",
}


class After(NamedTuple):
    """What follows the search: the sets ranked by `nrmse`, and their rows (S, n_table) [SI].

    Rows have the dead band and the delays of logs. `nrmse` (S,) is that of the final values over the fitted
    forward and reverse trials, starts from rest included. `settings` go into the result.
    """

    sets: RankedSets
    rows: FloatArray
    nrmse: FloatArray
    saturation: SaturationFit | None
    settings: dict[str, Any]
    cut: CutReason | None


def after_the_search(problem: MotorProblem, course: Course) -> After:
    """Fit the dead band, score the final sets, climb the ladder, walk the profile, notice what is doubtful.

    Where the fit is cut short, by now or in one of these steps, what is missing is noticed and left to
    ``--resume``.
    """
    cut = course.cut
    if cut is None:
        try:
            return _all_that_follows(problem, course)
        except CutShort as error:
            cut = error.reason
    rows = averaged(problem.space, problem.complete(course.sets.values))
    sets, rows, nrmse, _ = _ranked(course.sets, rows, None, _whole(problem))
    settings: dict[str, Any] = {"saturation": {"stage": "not fitted", "why": _WHY[cut]}}
    _notice_cut(cut, problem.space, banded=False, done=settings)
    if not problem.bench.scale_known:
        settings |= _scale_free(_is_given(problem))
    return After(sets, rows, nrmse, None, settings, cut)


def _whole(problem: MotorProblem) -> MotorProblem:
    """Return the trials of the dynamic fit, starts from rest included."""
    return problem.only([trial.entry.name for trial in problem.bench.fitted])


def _is_given(problem: MotorProblem) -> bool:
    """Return whether the campaign states the dead band."""
    return set(SATURATION) <= {*problem.bench.measured, *problem.campaign.parameters.fixed}


def _all_that_follows(problem: MotorProblem, course: Course) -> After:
    """Take every step that follows a search that was not cut short; the last ones may still be.

    Raises
    ------
    CutShort
        When the fit must end before the dead band was fitted.
    """
    bench, space = problem.bench, problem.space
    settings, go_on, given = course.settings, course.go_on, _is_given(problem)
    rows = averaged(space, problem.complete(course.sets.values))
    saturation = fit_saturation(problem, rows, settings, course.sets.seed, go_on)
    if saturation is not None:
        rows[:, [space.table.index[row.name] for row in saturation.free]] = saturation.values
    sets, rows, nrmse, saturation = _ranked(course.sets, rows, saturation, _whole(problem))
    best = named(space.table, rows[0])
    out: dict[str, Any] = {
        "reversal delays": reversal_delays(problem.campaign, bench, best),
        "command delays": log_delays(problem, rows[0]),
    }
    out["saturation"] = _about_saturation(bench, saturation, best, given)
    if saturation is not None:
        edges = edges_that_serve(problem, rows[0], saturation)
        out["saturation"]["saturation_speed that serves as well [rad/s]"] = edges
        if edges is not None:
            notice(
                "dead-band-edge-open",
                f"{', '.join(saturation.trials)} do not fix saturation_speed: from {edges[0]:.2g} to "
                f"{edges[1]:.2g} rad/s, with the saturation_current that fits best beside each, the NRMSE is "
                "within 1 % of the lowest; its digits mean nothing",
            )
    drop = best["winding_resistance"] / (best["torque_constant"] * best["back_emf_constant"])
    tied = ((d, tie) for d, tie in bench.curves.ties.items() if d in problem.ties)
    out["static curves of the best set"] = [
        tie.fit(d, drop, best["viscous_damping"]).document() for d, tie in tied
    ]
    cut: CutReason | None = None
    try:
        banded = saturation is not None or given
        climbed = climb(problem, best, banded, settings, sets.seed[0], go_on)
        below = (None, *climbed[:-1])
        out[_LADDER] = [rung.document(other) for rung, other in zip(climbed, below, strict=True)]
        for sentence in ladder_sentences(out[_LADDER]):
            notice("ladder", sentence)
        if _PROFILED in space.names:
            # Of the torque curve's linear coefficient, which stands beside k_d in the equation of the rotor.
            errors = [fit.standard_errors[1] for fit in bench.curves.fits if fit.quantity == "torque"]
            damping = profile(problem.fitted, _PROFILED, sets.cube[0], sets.seed[0], max(errors), go_on)
            out[_PROFILES] = {damping.name: damping.document()}
            if damping.sentence is not None:
                notice("not-identifiable", damping.sentence)
    except CutShort as error:
        cut = error.reason
        _notice_cut(cut, space, banded=True, done=out)
    logs = [trial.log for trial in bench.fitted]
    spikes = spike_inertia(problem.campaign, logs, unpack(rows[0, : len(PARAMETERS)]))
    out["rotor inertia from torque spikes"] = spikes.document()
    if spikes.sentence is not None:
        notice("inertia-from-spikes", spikes.sentence)
    if not bench.scale_known:
        out |= _scale_free(saturation is not None or given)
    return After(sets, rows, nrmse, saturation, out, cut)


def _notice_cut(cut: CutReason, space: SearchSpace, *, banded: bool, done: Mapping[str, Any]) -> None:
    """Name what a fit that was cut short has not looked at."""
    missing = [] if banded else ["the dead band was not fitted"]
    if _LADDER not in done:
        missing.append("the ladder of simpler models was not climbed")
    if _PROFILED in space.names and _PROFILES not in done:
        missing.append(f"{_PROFILED} was not profiled, so its digits may mean nothing")
    notice("cut-short", f"{_WHY[cut]}: {'; '.join(missing)}; continue it with --resume")


def _scale_free(banded: bool) -> dict[str, Any]:
    """Return which numbers of a motor of unknown scale are not fixed alone, and what they fix together."""
    alone = ["winding_resistance", "winding_inductance", *SATURATION[:1], *CONSTANTS]
    together = ["k2_over_R", "R_over_L", "electromechanical_time_constant"]
    return {NOT_ALONE: alone, COMBINATIONS: together[:2] + ["k_I_sat"] * banded + together[2:]}


def _ranked(
    sets: RankedSets, rows: FloatArray, saturation: SaturationFit | None, whole: MotorProblem
) -> tuple[RankedSets, FloatArray, FloatArray, SaturationFit | None]:
    """Rank the sets by the NRMSE of their final values, which the search has not seen."""
    nrmse = whole.cost.mean(whole.score(rows).by_channel)
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
    bench: Bench, saturation: SaturationFit | None, best: Mapping[str, float], given: bool
) -> dict[str, Any]:
    """Return what the result states of the second stage; notice what is doubtful about it."""
    if saturation is not None:
        tell(
            f"dead band from {saturation.shown_by} of {', '.join(saturation.trials)}: I_sat "
            f"{best['saturation_current']:.3g} A below {best['saturation_speed']:.3g} rad/s; NRMSE there "
            f"{100 * saturation.without[0]:.2f} % without, {100 * saturation.nrmse[0]:.2f} % with it"
        )
        if bench.banded[0].entry.direction != "reversal":
            notice(
                "dead-band-from-starts",
                "the dead band rests on starts from rest alone: a controller that takes another way through "
                "a reversal is not described by it; add a reversal trial of use = 'fit'",
            )
        return saturation.document()
    if given:
        return {"stage": "not fitted", "why": "given by the campaign"}
    why = "no trial of use = 'fit' shows them, by a reversal or by a start from rest inside its window"
    notice(
        "dead-band-not-fitted",
        f"saturation_current and saturation_speed are not fitted ({why}); they keep Table I's "
        f"{best['saturation_current']:g} A and {best['saturation_speed']:g} rad/s",
    )
    return {"stage": "not fitted", "why": why}


def log_delays(problem: MotorProblem, row: FloatArray) -> list[dict[str, Any]]:
    """Return the command delay of every log: as fitted, or as a log shows it that no stage has seen.

    `problem` holds all trials. A delay of the second kind is looked for on the log itself with all else held;
    the scores of that log do not use it.
    """
    bench = problem.bench
    values = named(problem.space.table, row)
    seen = {trial.entry.log for trial in (*bench.fitted, *bench.banded)}
    column = _INDEX["command_delay"]
    out: list[dict[str, Any]] = []
    for log in dict.fromkeys(trial.entry.log for trial in bench.trials):
        used = values.get(delay_name(log), values["command_delay"])
        fact: dict[str, Any] = {"log": log, "delay [s]": used, "estimated": log in seen}
        if log not in seen:
            alone = problem.only([trial.entry.name for trial in bench.trials if trial.entry.log == log])
            best, costs = used, np.zeros(1)
            for step in _DELAY_STEPS:
                around = best + step * np.arange(-_DELAY_REACH, _DELAY_REACH + 1)
                around = np.concatenate([[used], np.clip(around, 0.0, PARAMETERS["command_delay"].upper)])
                rows = np.repeat(row[None], around.size, axis=0)
                rows[:, column] = around
                costs = alone.cost.mean(alone.score(rows).by_channel)
                best = float(around[np.argmin(costs)])
            fact |= {"own delay [s]": best, "nrmse": float(costs[0])}
            fact["nrmse with its own delay"] = float(costs.min())
        out.append(fact)
    return out


def curve_sentence(fit: CurveFit) -> str:
    """Return a static curve in a sentence: coefficients, standard errors, how well the points lie on it."""
    names = ("a", "b") if fit.quantity == "no_load" else ("c2", "c1")
    each = zip(names, fit.coefficients, fit.standard_errors, fit.units, strict=True)
    numbers = ", ".join(f"{name} = {value:.5g} ± {error:.2g} {unit}" for name, value, error, unit in each)
    outliers = f", {fit.outliers} of them outliers" if fit.outliers else ""
    quality = f"R² {fit.r_squared:.5f} over {fit.points} points{outliers}"
    return f"{fit.quantity}, {fit.direction}: {numbers}; {quality}"


def begin(problem: MotorProblem) -> None:
    """Refuse a dead band that cannot be fitted, and tell what is free and what the logs showed."""
    campaign, bench, space = problem.campaign, problem.bench, problem.space
    saturation_space(campaign, bench, space.table, PARAMETERS.nominal)
    scored = len(bench.trials) - len(bench.fitted)
    tell(f"{len(bench.fitted)} trials to fit, {scored} to validate; free: {', '.join(space.names)}")
    for fit in bench.curves.fits:
        tell(curve_sentence(fit))
    for trial in bench.trials:
        tares = ", ".join(
            f"{name} {1e3 * tare.value:.3g} m{unit}"
            for name, unit in (("torque", "N·m"), ("thrust", "N"))
            if (tare := trial.log.tares.get(name)) is not None and np.isfinite(tare.error)
        )
        if tares:
            source = trial.log.tares["torque" if "torque" in trial.log.tares else "thrust"].source
            tell(f"trial {trial.entry.name}: tare from its {source}: {tares}")
        turned = " and ".join(name for name, sign in trial.log.signs.items() if sign < 0)
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


def notice_unresolved_inductance(bench: Bench, row: FloatArray) -> None:
    """Notice where L/R of the best set is shorter than the logs can show."""
    rise = float(row[_INDEX["winding_inductance"]] / row[_INDEX["winding_resistance"]])
    # A rise within one step of the finest grid that any fitted log is compared on leaves no sample inside it.
    finest = min(float(np.median(np.diff(trial.target.time))) for trial in bench.fitted)
    if rise <= finest:
        notice(
            "inductance-unresolved",
            f"L/R of the best set is {1e3 * rise:.3g} ms and the finest fitted log is compared every "
            f"{1e3 * finest:.3g} ms: the logs only say that L is small, not how small",
        )
