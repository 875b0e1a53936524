"""`sysid check CAMPAIGN`: are the logs good, do they excite the model, and what will they fix?"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign, MotorCampaign, read_campaign
from sysid.campaign.file import resolve_log
from sysid.gear.candidates import capture_noise, centre_of_mass, excitation, suggest_drops
from sysid.gear.drops import PreparedDrop, prepare_drops, read_drop_log
from sysid.gear.problem import on_surface, say_dropped
from sysid.gear.trust import GearProblem
from sysid.motor.candidates import suggest_trials
from sysid.motor.known_values import Bench, prepare_bench
from sysid.motor.targets import PreparedTrial
from sysid.motor.trust import MotorProblem, noise_correlation
from sysid.parameters import SearchSpace
from sysid.recording import file_sha256
from sysid.trials.look import LogReport, inspect_recording
from sysid.trust.problem import Block
from sysid.trust.sensitivity import Candidate, Outlook, expectations, information_by_channel, placed
from sysid.trust.verdicts import WEAKLY, WELL, Expected, percent, sentences, verdict
from sysid.types import FloatArray
from sysid.workflows.reopen import gear_problem, motor_problem
from sysid.workflows.search import collected_warnings, naming

# Candidates that are named.
_NAMED = 3


def check_campaign(
    path: Path,
    *,
    surface: str | None = None,
    threads: int | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Judge a campaign before it is fitted.

    Parameters
    ----------
    path : Path
        Campaign file.
    surface : str, optional
        Overrides a gear campaign's friction law.
    threads : int, optional
    say : callable, optional

    Returns
    -------
    dict
        ``quality`` (per log), ``excitation``, ``parameters`` (verdicts), ``channels`` (share of what each
        tells), ``candidates`` (recordings, the best first), ``sentences``, ``warnings``.

    Raises
    ------
    SysidError
        When an input cannot be used.
    """
    began = time.perf_counter()
    with naming(path), collected_warnings(say and (lambda text: say(f"warning: {text}"))) as doubts:
        campaign = read_campaign(path)
        if isinstance(campaign, GearCampaign):
            dropped: tuple[str, ...] = ()
            if surface is not None:
                campaign, dropped = on_surface(campaign, surface)
            say_dropped(campaign, dropped)
            found = _check_gear(campaign, path, threads)
        else:
            assert isinstance(campaign, MotorCampaign)
            found = _check_motor(campaign, path, threads)
    return {
        "campaign": {"file": path.name, "sha256": file_sha256(path), "name": campaign.name},
        "kind": campaign.kind,
        **found,
        "warnings": list(doubts),
        "seconds": time.perf_counter() - began,
    }


def nominal_point(space: SearchSpace) -> FloatArray:
    """Return the model's default values (n,) in the unit cube: what is known before a fit."""
    return placed(space, np.array([space.table[name].nominal for name in space.names]))


def quick_gear(problem: GearProblem) -> tuple[Expected, ...]:
    """Return what drops are expected to fix at the default values; takes a second."""
    noise = capture_noise(problem)
    return expectations(problem, nominal_point(problem.space), noise, over_bounds=False)[1]


def quick_motor(problem: MotorProblem) -> tuple[Expected, ...]:
    """Return what bench trials are expected to fix at the default values."""
    noise = noise_correlation(problem)
    return expectations(problem, nominal_point(problem.space), noise, over_bounds=False)[1]


def _check_gear(campaign: GearCampaign, path: Path, threads: int | None) -> dict[str, Any]:
    drops = prepare_drops(campaign, path)
    problem = gear_problem(campaign, drops, threads)
    noise = capture_noise(problem)
    here, expected = expectations(problem, nominal_point(problem.space), noise)
    weak = np.array([one.verdict != "well" for one in expected])
    candidates: tuple[Candidate, ...] = ()
    if weak.any():
        candidates = suggest_drops(campaign, problem, here, noise, weak)
    out = _verdicts(problem, problem.blocks, here, expected, candidates)
    out["quality"] = [_drop_quality(campaign, path, drop) for drop in drops]
    out["excitation"] = excitation(problem)
    out["centre_of_mass"] = centre_of_mass(drops, campaign)
    return out


def _check_motor(campaign: MotorCampaign, path: Path, threads: int | None) -> dict[str, Any]:
    bench = prepare_bench(campaign, path)
    problem = motor_problem(campaign, bench, threads)
    noise = noise_correlation(problem)
    here, expected = expectations(problem, nominal_point(problem.space), noise)
    weak = np.array([one.verdict != "well" for one in expected])
    candidates: tuple[Candidate, ...] = ()
    if weak.any():
        candidates = suggest_trials(campaign, bench, problem, here, noise, weak)
    out = _verdicts(problem, problem.blocks, here, expected, candidates)
    out["sentences"] += _motor_advice(bench, expected)
    out["quality"] = [_bench_quality(trial) for trial in bench.trials]
    commands = [trial.log.steps.level for trial in bench.trials]
    speeds = [trial.target.measured[:, 1][trial.target.valid[:, 1]] for trial in bench.fitted]
    out["excitation"] = {
        "command": [float(min(c.min() for c in commands)), float(max(c.max() for c in commands))],
        "commands": int(sum(len(c) for c in commands)),
        "speed": [float(min(s.min() for s in speeds)), float(max(s.max() for s in speeds))],
        "reversals": sum(trial.entry.direction == "reversal" for trial in bench.trials),
    }
    return out


def _bench_quality(trial: PreparedTrial) -> dict[str, Any]:
    """Return the quality of a log of commands, without what reading it has put right: tare and signs."""
    report = inspect_recording(trial.log.recording)
    handled = ["no-tare"] * bool(trial.log.tares) + ["thrust-falls"] * (trial.entry.direction != "forward")
    kept = tuple(finding for finding in report.suspicions if finding.code not in handled)
    report = replace(report, suspicions=kept)
    return _log_quality(trial.entry.name, trial.entry.use, report) | {"second log": trial.log.second}


def _motor_advice(bench: Bench, expected: tuple[Expected, ...]) -> list[str]:
    """Return what to record next for the parameters that bench trials do not fix well."""
    names = {one.name for one in expected if one.verdict != "well"}
    out = []
    if "viscous_damping" in names:
        out.append(
            "to fix k_d: a log without propeller in which the unpowered rotor coasts down; beside a "
            "propeller its drag is lost in the error of the torque curve"
        )
    if "winding_inductance" in names:
        out.append(
            "L shows in what follows a step within milliseconds: record with a load cell at 1 kHz or more"
        )
    if "winding_resistance" in names:
        out.append("R rests on the static curves: record more steady points, with propeller and without")
    if not any(trial.entry.direction == "reversal" for trial in bench.trials):
        out.append("no reversal was recorded: nothing fixes I_sat and Ω_min, which decide its delay")
    return out


def _verdicts(
    problem: GearProblem | MotorProblem,
    blocks: tuple[Block, ...],
    here: Outlook,
    expected: tuple[Expected, ...],
    candidates: tuple[Candidate, ...],
) -> dict[str, Any]:
    shares = information_by_channel(problem, here)
    said = list(sentences(expected))
    names = problem.space.names
    # Derivatives that depend on the step make a verdict a guess.
    rough = [name for name, good in zip(names, here.jacobian.trusted, strict=True) if not good]
    if rough:
        said.append(f"derivatives of {', '.join(rough)} change with the step: their verdicts are rough")
    for i, one in enumerate(expected):
        better = [c for c in candidates if verdict(float(c.half_widths[i])) != one.verdict]
        if one.verdict == "well" or not candidates:
            continue
        best = min(candidates, key=lambda c, i=i: float(c.half_widths[i]))  # type: ignore[misc]
        after = float(best.half_widths[i])
        if better and after < one.half_width:
            said.append(
                f"to fix {one.symbol}: {best.title} ({percent(one.half_width)} now, {percent(after)} with it)"
            )
        else:
            what = "level drop on this surface" if isinstance(problem, GearProblem) else "trial of its kind"
            said.append(f"no single {what} within the lab's reach fixes {one.symbol}")
    # Worth recording is what lifts a verdict.
    lifting = [(c, [e.symbol for e, w in zip(expected, c.half_widths, strict=True) if _lifts(e, w)])
               for c in candidates]  # fmt: skip
    worth = [f"{c.title} (lifts {', '.join(symbols)})" for c, symbols in lifting if symbols]
    if worth:
        said.append("record next: " + ", else ".join(worth[:_NAMED]))
    return {
        "parameters": [
            one.document() | {"channels": dict(zip(problem.channels, share.tolist(), strict=True))}
            for one, share in zip(expected, shares, strict=True)
        ],
        "limits": {"well": WELL, "weakly": WEAKLY},
        "candidates": [
            {
                "title": c.title,
                "gain": c.gain,
                "half_widths": dict(zip(names, c.half_widths.tolist(), strict=True)),
                "verdicts": {n: verdict(float(w)) for n, w in zip(names, c.half_widths, strict=True)},
            }
            for c in candidates
        ],
        "sentences": said,
    }


def _lifts(one: Expected, half_width: float) -> bool:
    """Return whether a half-width belongs to a better verdict than what is expected now."""
    return half_width < one.half_width and verdict(float(half_width)) != one.verdict


def _drop_quality(campaign: GearCampaign, path: Path, drop: PreparedDrop) -> dict[str, Any]:
    trial = next(one for one in campaign.trials if one.name == drop.name)
    log = resolve_log(path, trial.log)
    recording = read_drop_log(campaign, log, trial.rigid_body, trial.log_options.model_dump_json())
    report = inspect_recording(recording, campaign.vehicle.gravity)
    window = (drop.motion.time >= drop.time[0]) & (drop.motion.time <= drop.time[-1])
    noise = drop.flight.noise
    return _log_quality(drop.name, drop.use, report) | {
        "slope_deg": float(np.degrees(drop.slope)),
        "noise": {"x [m]": float(noise[0]), "z [m]": float(noise[1]), "pitch [rad]": float(noise[2])},
        "gravity": drop.flight.measured_gravity,
        "gravity_error": _fall_error(drop),
        "held": drop.flight.held,
        "release": drop.flight.start,
        "touchdown": drop.touchdown,
        "impact_speed": drop.impact_speed,
        "lost_in_window": int(np.sum(~drop.motion.valid[window])),
        "out_of_plane_deg": float(
            np.degrees(np.nanmax(np.abs([drop.motion.roll[window], drop.motion.yaw[window]])))
        ),
        "notes": list(drop.provenance["notes"]),
    }


def _fall_error(drop: PreparedDrop) -> float:
    """Return the standard error of g as the fall itself tells it [m/s²].

    Of a parabola through n samples of noise σ over a time T: σ sqrt(720/n)/T².
    """
    lasts = drop.touchdown - drop.flight.start
    count = lasts * drop.motion.rate
    return float(drop.flight.noise[1] * math.sqrt(720.0 / count) / lasts**2) if count > 3 else math.nan


def _log_quality(name: str, use: str, report: LogReport) -> dict[str, Any]:
    channels = report.channels
    return {
        "name": name,
        "use": use,
        "log": Path(report.path).name,
        "rate": max((c.rate for c in channels), default=math.nan),
        "jitter": max((c.jitter for c in channels), default=math.nan),
        "holes": max((c.holes for c in channels), default=0),
        "saturated": max((c.saturated for c in channels), default=0.0),
        "suspicions": [str(finding) for finding in report.suspicions],
    }
