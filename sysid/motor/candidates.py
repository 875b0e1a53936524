"""Bench trials that could be recorded next, simulated as they would be compared.

Reversals are no candidates: they show I_sat and Ω_min, which are fitted after everything else. Nor is a rotor
without propeller that coasts down, which shows k_d: it is another motor to the dynamic fit.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.motor.problem import MotorProblem
from sysid.motor.targets import PreparedTrial
from sysid.types import FloatArray

# Length of a candidate [s]; steps are tried for three times as long, too.
_LASTS = 4.0
# Time between two steps, and between two commands of a ramp or sine [s].
_HELD, _WRITTEN = 0.5, 0.01
# Pairs of commands to step between [share of full].
_STEPS = ((0.3, 0.6), (0.3, 0.9), (0.6, 0.9))
# Mean and amplitude of sines [share of full], and their frequency [Hz].
_SINES = ((0.6, 0.2, 1.0), (0.6, 0.2, 4.0), (0.6, 0.2, 12.0))
# Ends of a ramp [share of full].
_RAMP = (0.2, 1.0)


def candidate_trials(problem: MotorProblem, row: FloatArray) -> tuple[MotorProblem, Sequence[str]] | None:
    """Return trials that could be made next at a row (n_table,) [SI], and what they are called.

    None where none of them can be simulated.
    """
    rows = problem.complete(row[None])
    trials: list[PreparedTrial] = []
    titles: list[str] = []
    noise: list[FloatArray] = []
    levels = {(b.trial, b.channel): b.noise * b.spread for b in problem.blocks}
    for t, template in enumerate(problem.prepared):
        if template.entry.direction in {trial.entry.direction for trial in trials}:
            continue
        sign = -1.0 if template.entry.direction == "reverse" else 1.0
        for title, time, command in _commands():
            trial = _candidate(problem, template, rows, time, sign * command)
            if trial is not None:
                titles.append(f"{title}, {template.entry.direction}")
                trials.append(replace(trial, entry=trial.entry.model_copy(update={"name": titles[-1]})))
                # Simulated samples show no noise.
                noise.append(np.array([levels.get((t, c), np.nan) for c in range(2)]))
    if not trials:
        return None
    return replace(problem.of(tuple(trials)), stated_noise=np.array(noise)), titles


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
        title = f"a sine of {100 * mean:g} ± {100 * swing:g} % at {rate:g} Hz for {_LASTS:g} s"
        out.append((title, fine, command))
    return out


def _candidate(
    problem: MotorProblem, template: PreparedTrial, row: FloatArray, time: FloatArray, command: FloatArray
) -> PreparedTrial | None:
    """Return a trial as it would be compared at a row (1, n) of the table; None where it cannot be simulated.

    With the template's sampling, filter, channels and delay. The delay of a new log would be one more
    unknown, which steps of the command determine.
    """
    before = template.target
    half = max(0, len(before.taps) - 1)
    step = before.grid_step
    stride = max(1, round(float(np.median(np.diff(before.time))) / step))
    # The filter and the longest delay look back over steady samples.
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
        command=np.concatenate([[command[0]], command]), time=grid, supply=None,
        mapped=problem.bench.curves.mapped(np.concatenate([[command[0]], command])),
    )  # fmt: skip
    trial = replace(template, simulated=schedule, target=blank, starts=(), thrust=None)
    prediction = problem.of((trial,)).predict(row)
    if np.any(prediction.cause):
        return None
    return replace(trial, target=replace(blank, measured=prediction.signals[0][0]))
