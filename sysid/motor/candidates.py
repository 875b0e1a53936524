"""Which bench trial to record next: commands are simulated at the default values and ranked by what they add.

Reversals are no candidates: what they tell is I_sat and Ω_min, which are fitted after everything else. Nor is
a rotor without propeller that coasts down, which tells k_d: it is another motor to the dynamic fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.motor.known_values import Bench
from sysid.motor.objective import MotorObjective
from sysid.motor.targets import PreparedTrial
from sysid.motor.trust import MotorProblem
from sysid.trust.linearized import NoiseModel
from sysid.trust.sensitivity import Candidate, Outlook, rank_candidates
from sysid.types import BoolArray, FloatArray
from sysid.workflows.reopen import bench_problem

# Of a candidate, but the one that is said to be longer [s]; a step is held, a slow command written so often.
_LASTS, _HELD, _WRITTEN = 4.0, 0.5, 0.01
# Pairs of commands to step between, and (mean, amplitude, frequency [Hz]) of sines [share of full].
_STEPS = ((0.3, 0.6), (0.3, 0.9), (0.6, 0.9))
_SINES = ((0.6, 0.2, 1.0), (0.6, 0.2, 4.0), (0.6, 0.2, 12.0))
_RAMP = (0.2, 1.0)


def suggest_trials(
    campaign: MotorCampaign,
    bench: Bench,
    problem: MotorProblem,
    here: Outlook,
    noise: NoiseModel,
    weak: BoolArray,
) -> tuple[Candidate, ...]:
    """Simulate trials that could be made next and rank them by what they add, the best first."""
    row = problem.objective.complete(problem.space.full(here.point[None]))
    trials: list[PreparedTrial] = []
    titles: list[str] = []
    levels: list[dict[int, float]] = []
    for template in problem.objective.trials:
        if template.entry.direction in {trial.entry.direction for trial in trials}:
            continue
        sign = -1.0 if template.entry.direction == "reverse" else 1.0
        sigma = _noise_of(problem, template)
        for title, time, command in _commands():
            made = _candidate(campaign, bench, problem, template, row, time, sign * command)
            if made is not None:
                trials.append(made)
                titles.append(f"{title}, {template.entry.direction}")
                levels.append(sigma)
    if not trials:
        return ()
    objective = MotorObjective.build(
        campaign, problem.space, bench, tuple(trials), problem.objective.threads, dynamic=True
    )
    others = bench_problem(campaign, bench, objective)
    # Simulated samples show no noise of their own.
    known = tuple(
        replace(block, noise=levels[block.trial][block.channel] / block.spread) for block in others.blocks
    )
    object.__setattr__(others, "blocks", known)
    return rank_candidates(problem, here, noise, others, tuple(titles), weak, common=problem.common)


def _commands() -> list[tuple[str, FloatArray, FloatArray]]:
    """Return (title, instants [s], share of full command) of what a bench can play."""
    out = []
    for length in (_LASTS, 3 * _LASTS):
        beats = np.arange(0.0, length, _HELD)
        for low, high in _STEPS:
            command = np.where(np.arange(len(beats)) % 2 == 0, low, high)
            title = f"steps between {100 * low:g} and {100 * high:g} % every {_HELD:g} s for {length:g} s"
            out.append((title, beats, command))
    fine = np.arange(0.0, _LASTS, _WRITTEN)
    low, high = _RAMP
    ramp = low + (high - low) * fine / _LASTS
    out.append((f"a ramp from {100 * low:g} to {100 * high:g} % in {_LASTS:g} s", fine, ramp))
    for mean, swing, rate in _SINES:
        command = mean + swing * np.sin(2 * np.pi * rate * fine)
        out.append(
            (f"a sine of {100 * mean:g} ± {100 * swing:g} % at {rate:g} Hz for {_LASTS:g} s", fine, command)
        )
    return out


def _noise_of(problem: MotorProblem, template: PreparedTrial) -> dict[int, float]:
    """Return the noise of each channel of a trial as compared [its unit]."""
    t = problem.objective.trials.index(template)
    return {b.channel: b.noise * b.spread for b in problem.blocks if b.trial == t}


def _candidate(
    campaign: MotorCampaign,
    bench: Bench,
    problem: MotorProblem,
    template: PreparedTrial,
    row: FloatArray,
    time: FloatArray,
    command: FloatArray,
) -> PreparedTrial | None:
    """Return a trial as it would be compared at a row (1, n) of the table; None where it cannot be simulated.

    With the template's sampling, filter and channels, and its own delay (a new log's would be one more
    unknown, which steps of the command fix).
    """
    before = template.target
    half = max(0, len(before.taps) - 1)
    step = before.grid_step
    stride = max(1, round(float(np.median(np.diff(before.time))) / step))
    # As many steady samples in front as the filter and the longest delay look back.
    lead = half * step + 0.5
    lasts = float(time[-1]) + max(_HELD, float(time[-1] - time[-2]))
    grid = np.arange(0.0, lead + lasts + half * step, step)
    rows = np.arange(half, grid.size - half, stride)
    rows = rows[grid[rows] >= lead - 0.2]
    blank = replace(
        before, time=grid[rows], measured=np.random.default_rng(0).standard_normal((rows.size, 2)),
        valid=np.broadcast_to(before.valid.any(axis=0), (rows.size, 2)).copy(),
        grid_start=0.0, grid_size=grid.size,
    )  # fmt: skip
    schedule = replace(
        template.simulated, command_time=np.concatenate([[-1.0], lead + time]),
        command=np.concatenate([[command[0]], command]), time=grid, supply_time=None, supply_ratio=None,
    )  # fmt: skip
    trial = replace(template, simulated=schedule, target=blank, starts=(), thrust=None)
    objective = MotorObjective.build(
        campaign, problem.space, bench, (trial,), problem.objective.threads, dynamic=True
    )
    samples, reached = objective.simulate(row)
    if np.any(reached < 1.0):
        return None
    clean = objective.cost.prepared(samples, objective.sensors(row))[0][0]
    return replace(trial, target=replace(blank, measured=clean))
