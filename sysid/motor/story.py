"""Descriptions of a bench: the quality of its logs, what they excite, the points behind its static curves."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from sysid.fit.result import FitResult
from sysid.fit.story import Read, ReadTrial, Story
from sysid.fit.trial import Trial
from sysid.motor.cost import CHANNELS
from sysid.motor.curves import supply_ratio
from sysid.motor.inertia import spikes
from sysid.motor.known_values import KEYS, NO_INDUCTANCE
from sysid.motor.model import PARAMETERS, unpack
from sysid.motor.parameters import LOAD_CELLS
from sysid.motor.problem import MotorProblem
from sysid.motor.static_curves import turns
from sysid.motor.targets import filter_design
from sysid.parameters import common_name
from sysid.trials.look import inspect_recording, log_quality
from sysid.types import FloatArray

# Least number of samples after a command, and least change of the speed by it [1], that are read.
_LEAST, _CHANGE = 20, 0.1
_ADVICE = {
    "viscous_damping": (
        "to determine k_d: a log without propeller in which the unpowered rotor coasts down; beside a "
        "propeller its drag is lost in the error of the torque curve"
    ),
    "winding_inductance": (
        "L shows in what follows a step within milliseconds: record with a load cell at 1 kHz or more"
    ),
    "winding_resistance": (
        "R rests on the static curves: record more steady points, with propeller and without"
    ),
}


class MotorStory(Story[MotorProblem]):
    """Descriptions of the trials of a bench."""

    stated_example = "920 rpm/V ± 2 %"

    @property
    def keys(self) -> Mapping[str, str]:
        """Kv and load cells by their keys, and the curves of static logs by what they are."""
        rows = (row.name for curve in self.problem.bench.measured_curves for row in curve.rows)
        cells = dict.fromkeys((row.name for row in LOAD_CELLS), "calibration_error")
        return {**KEYS, **dict.fromkeys(rows, "static curves"), **cells}

    @property
    def hashes(self) -> Mapping[str, str]:
        """SHA-256 of every log, of the static logs as well."""
        out = {}
        for name, provenance in self.logs.items():
            both = (provenance, provenance.get("second_log"))
            out[name] = " ".join(str(file["sha256"]) for file in both if isinstance(file, dict))
        return out

    @property
    def logs(self) -> Mapping[str, Mapping[str, object]]:
        """What a result states of every log, of the static logs as well."""
        return {trial.entry.name: trial.provenance for trial in self.problem.bench.trials} | {
            log.name: log.provenance for log in self.problem.bench.curves.logs
        }

    @property
    def filters(self) -> Mapping[str, object]:
        """The filter of the fast logs, and which logs went without."""
        return filter_design(self.problem.campaign, [trial.log for trial in self.problem.bench.trials])

    def drawn(self, fit: FitResult, values: FloatArray) -> FloatArray:
        """Return rows; a log new to the fit lags its command as the fitted logs do, within their scatter."""
        rows, index = super().drawn(fit, values), self.problem.space.table.index
        delays = np.array([
            value for value, record in zip(fit.values[0], fit.parameters, strict=True)
            if record.trial and common_name(record) == "command_delay"
        ])  # fmt: skip
        if len(delays) > 1:
            random, scatter = np.random.default_rng(0), delays.std(ddof=1) * np.sqrt(1 + 1 / len(delays))
            for name in self.problem.row_logs:
                if name in index and np.all(rows[:, index[name]] == rows[:, index["command_delay"]]):
                    rows[1:, index[name]] += scatter * random.standard_normal(len(rows) - 1)
        return rows

    def read(self, fit: FitResult, values: FloatArray) -> list[ReadTrial]:
        """Return of every command the speed in the end, when 90 % of it is there, when it passes zero."""
        random, noise = np.random.default_rng(1), np.nan_to_num(self.problem.noise[:, 1])
        out = []
        for trial, predicted, sigma in zip(
            self.problem.trials, self.signals(fit, values), noise, strict=True
        ):
            measured = np.where(trial.valid[:, 1], trial.measured[:, 1], np.nan)
            tracks = np.concatenate([measured[None], predicted[:, :, 1]])
            tracks[2:] += sigma * random.standard_normal(tracks[2:].shape)
            out.append(_read(trial, tracks))
        return out

    def quality(self) -> list[dict[str, object]]:
        """Return how good every log is, without what reading it has put right: tare and signs."""
        out = []
        for trial in self.problem.prepared:
            report, entry = inspect_recording(trial.log.recording), trial.entry
            handled = ["no-tare"] * bool(trial.log.tares) + ["thrust-falls"] * (entry.direction != "forward")
            left = tuple(finding for finding in report.suspicions if finding.code not in handled)
            quality = log_quality(entry.name, entry.use, replace(report, suspicions=left))
            out.append(quality | {"second_log": trial.log.second})
        return out

    def excitation(self) -> dict[str, object]:
        """Return the ranges of commands and speeds [rad/s], and the numbers of commands and reversals."""
        commands = np.concatenate([trial.log.steps.level for trial in self.problem.prepared])
        targets = (trial.target for trial in self.problem.bench.fitted)
        speeds = np.concatenate([target.measured[target.valid[:, 1], 1] for target in targets])
        return {
            "command": [float(commands.min()), float(commands.max())],
            "commands": commands.size,
            "speed": [float(speeds.min()), float(speeds.max())],
            "reversals": sum(trial.entry.direction == "reversal" for trial in self.problem.prepared),
        }

    def advice(self, weak: Collection[str]) -> list[str]:
        """Return what to record next for the parameters that bench trials do not determine well."""
        slow = not any(trial.log.fast for trial in self.problem.prepared)
        told = weak if slow else {*weak} - {"winding_inductance"}
        out = [sentence for name, sentence in _ADVICE.items() if name in told]
        if "winding_inductance" in self.problem.bench.guessed & {*self.problem.space.fixed}:
            out.append(NO_INDUCTANCE)
        if not any(trial.entry.direction == "reversal" for trial in self.problem.prepared):
            out.append("no reversal was recorded: nothing shows I_sat and Ω_min, which decide its delay")
        return out

    def floor(self, row: FloatArray) -> FloatArray:
        """Return the floors (T, 2) [channel units]; NaN where a channel has no weight."""
        out = np.full((len(self.problem.prepared), len(CHANNELS)), np.nan)
        for block, level in zip(self.problem.blocks, self.problem.floors(row), strict=True):
            out[block.trial, block.channel] = level
        return out * self.problem.cost.denominators

    def evidence(self, row: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return steady points as (Ω, thrust), (Ω, torque) and (u, Ω_0), and spikes as (dΩ/dt, torque).

        Ω_0 of loaded points is lifted by what the drag of the row takes. The names are a quantity and a
        direction, ``thrust_forward``; ``spikes_up`` has torque above the static one.
        """
        curves, out = self.problem.bench.curves, {}
        values = unpack(self.problem.complete(row[None])[0], self.problem.space.table)
        drop = values["winding_resistance"] / (values["torque_constant"] * values["back_emf_constant"])
        for direction, points in curves.loaded.items():
            turning = turns(points.speed, direction)
            for name in ("thrust", "torque"):
                out[f"{name}_{direction}"] = points.speed[turning], getattr(points, name)[turning]
            if direction in curves.ties:
                tie = curves.ties[direction]
                speed, torque = tie.points.T
                lifted = speed + drop * (torque + values["viscous_damping"] * speed)
                out[f"no_load_{direction}"] = tie.columns[:, 0], lifted
        for log in curves.logs:
            if log.table == "no_load":
                ratio = supply_ratio(log.points, curves.reference_voltage)
                out[f"no_load_{log.entry.direction}"] = log.points.u, log.points.speed / ratio
        table = PARAMETERS.filled(values)
        found = list(spikes(self.problem.campaign, [trial.log for trial in self.problem.bench.fitted], table))
        for kind in dict.fromkeys(each[0] for each in found):
            parts = [each[1:] for each in found if each[0] == kind]
            acceleration, excess = (np.concatenate(each) for each in zip(*parts, strict=True))
            out[f"spikes_{kind}"] = acceleration, excess
        return out


def _read(trial: Trial, speeds: FloatArray) -> ReadTrial:
    """Return the numbers of speeds (n, samples) [rad/s], the measured one first, all read alike."""
    numbers, time = [], trial.time
    commands = trial.shown["commands"]
    begins = commands[:, 0]
    for step, (begin, end) in enumerate(zip(begins, [*begins[1:], time[-1]], strict=True), 1):
        part = np.flatnonzero((time >= begin) & (time <= end))
        if len(part) < _LEAST or begin <= time[0]:
            continue
        track, since = speeds[:, part], 1000 * (time[part] - begin)
        first, last = track[:, 0], track[:, -max(1, len(part) // 5) :].mean(axis=1)
        which = f"step {step}"
        numbers.append(Read(f"speed, after {which}", "rad/s", last))
        if abs(last[0] - first[0]) < _CHANGE * abs(first[0]):
            continue
        numbers.append(
            Read(f"time to 90 %, {which}", "ms", _passes(since, track, first + 0.9 * (last - first)))
        )
        if first[0] * last[0] < 0:
            numbers.append(Read(f"time to zero speed, {which}", "ms", _passes(since, track, 0.0 * first)))
    return ReadTrial(numbers)


def _passes(time: FloatArray, tracks: FloatArray, levels: FloatArray) -> FloatArray:
    """Return when (n,) tracks (n, samples) first pass from their start through a level (n,)."""
    passed = (tracks - levels[:, None]) * (tracks[:, :1] - levels[:, None]) < 0
    at, each = np.maximum(np.argmax(passed, axis=1), 1), np.arange(len(tracks))
    before, after = tracks[each, at - 1], tracks[each, at]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (levels - before) / (after - before)
    return np.where(passed.any(axis=1), time[at - 1] + share * (time[at] - time[at - 1]), np.nan)
