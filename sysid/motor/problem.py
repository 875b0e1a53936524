"""The trials of a bench as a fit problem: searched, scored, differentiated, predicted.

Trust judges what the dynamic fit frees: R, L, k_d, the delays and the like. The dead band, which is fitted
after it with all other values fixed, takes no part in trust.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.campaign import MotorCampaign
from sysid.campaign.swaps import Swap
from sysid.filters import shown_noise
from sysid.fit.compiling import tell_of_kernel
from sysid.fit.problem import Problem
from sysid.fit.result import FitResult
from sysid.fit.trial import NoiseModel, Prediction, Scores, Trial
from sysid.motor import kernel
from sysid.motor.batch import SimulatedTrials, simulate_population
from sysid.motor.cost import CHANNELS, BenchCost, MotorTarget
from sysid.motor.known_values import CONSTANTS, Bench
from sysid.motor.log_delays import delay_name, shifts
from sysid.motor.model import PARAMETERS
from sysid.motor.parameters import LOAD_CELLS, SENSORS
from sysid.motor.static_curves import MEASURED_CURVE, MeasuredCurve, NoLoadTie, no_load_line
from sysid.motor.targets import PreparedTrial, measured_spectrum
from sysid.parallel import threads_for
from sysid.parameters import Parameter, SearchSpace
from sysid.stated import Stated
from sysid.trials.bench_log import STANDS
from sysid.types import BoolArray, FloatArray, IntArray, Rotation

# Relative local error of the simulations of a search: 1e-5 keeps the worst candidate within 0.01 % NRMSE.
FIT_TOLERANCE = 1e-5
# Simulated samples in memory at once, per thread [bytes]: the allocator keeps blocks of this size; for larger
# ones it asks the system for fresh pages every time, which costs more than simulating.
_MEMORY = 4e6
# Time after a command that counts as its transient, several times a motor's time constant [s].
_FOLLOWS = 0.3
# Approximate number of parts of all trials together that a ladder leaves out in turn.
_PIECES = 12
# Wrong entries of the number of poles, and the ratio of the true speeds to the recorded ones [1].
_WRONG_POLES = {
    "a stand set to 14 poles for a motor of 12": 14 / 12,
    "a stand set to 12 poles for a motor of 14": 12 / 14,
    "a stand set to poles where it asks for pairs": 2.0,
    "a stand set to pairs of poles where it asks for poles": 0.5,
}
_INDEX = PARAMETERS.index
_INSTRUMENTS = PARAMETERS.group("instrument")


@dataclass(frozen=True, eq=False)
class MotorProblem(Problem):
    """Trials of one bench; see `sysid.fit.problem.Problem`.

    `bench` has all logs of the campaign, `prepared` the trials of this problem, `targets` what each trial
    compares. `ties` are the no-load lines that follow R and k_d. With an `ideal_reversal` there is no
    saturation (I_sat = ∞), as in Fig. 11. `stated_noise` (T, 2) is the standard deviation of the noise of
    trials that were never recorded [channel units].
    """

    campaign: MotorCampaign
    bench: Bench
    space: SearchSpace
    prepared: tuple[PreparedTrial, ...]
    targets: tuple[MotorTarget, ...]
    ties: Mapping[Rotation, NoLoadTie]
    threads: int | None = None
    ideal_reversal: bool = False
    stated_noise: FloatArray | None = None
    # These are the kernel's statuses in their order. Too expensive is a trial of some hundred times the steps
    # of an ordinary one: a resumed fit meets that bound at the same step, in less than 0.1 s.
    causes = ("no_steady_state", "too_expensive", "not_finite", "step_collapsed")
    # Load cells and tachometers of thrust stands are accurate to 0.5 % and better.
    small = 2e-3

    @classmethod
    def build(
        cls,
        campaign: MotorCampaign,
        space: SearchSpace,
        bench: Bench,
        trials: tuple[PreparedTrial, ...],
        threads: int | None = None,
    ) -> MotorProblem:
        """Join prepared trials with their campaign."""
        # No-load lines that are neither free nor fixed by the campaign follow R and k_d.
        chosen = {*space.names, *campaign.parameters.fixed}
        ties = {d: tie for d, tie in bench.curves.ties.items() if not {*no_load_line(d)} & chosen}
        return cls(campaign, bench, space, trials, tuple(t.target for t in trials), ties, threads)

    @property
    def remedy(self) -> str:  # type: ignore[override]
        """What slow logs give although the model does not explain them."""
        if all(trial.log.fast for trial in self.prepared):
            return ""
        return (
            "thrust, torque and time constants of the stand do not depend on it: use those; for R and L "
            "record torque and speed at 1 kHz or more"
        )

    @property
    def unmoved(self) -> dict[tuple[str, ...], FloatArray]:
        """Covariances of thrust curves, which nothing moves, with the calibration of the load cell."""
        share = self.campaign.log.calibration_error
        return {
            tuple(fit.parameters): fit.covariance + share**2 * np.outer(fit.coefficients, fit.coefficients)
            for fit in self.bench.curves.fits
            if fit.quantity == "thrust" and not {*fit.parameters} & {*self.campaign.parameters.fixed}
        }

    # --- what is compared -----------------------------------------------------------------------------------

    @cached_property
    def trials(self) -> tuple[Trial, ...]:
        """The trials, counted from the start of their window."""
        return tuple(
            Trial(
                trial.entry.name, trial.entry.use, target.time, target.measured, target.valid,
                trial.provenance, float(target.time[0]),
                {
                    "spectrum": measured_spectrum(trial.log, target.time) if trial.log.fast else None,
                    "thrust": trial.thrust,
                    "commands": np.column_stack([trial.log.steps.time, trial.log.steps.level]),
                },
            )
            for trial, target in zip(self.prepared, self.targets, strict=True)
        )  # fmt: skip

    @cached_property
    def cost(self) -> BenchCost:
        """The campaign's NRMSE over the trials."""
        weights = self.campaign.cost.weights
        return BenchCost(self.targets, (weights.torque, weights.speed), self.campaign.cost.denominator)

    @cached_property
    def jobs(self) -> SimulatedTrials:
        """What the kernel simulates."""
        return SimulatedTrials([trial.simulated for trial in self.prepared])

    def only(self, names: Sequence[str]) -> MotorProblem:
        """Return the problem of some of the trials, in the order of their `names`."""
        chosen = [self.names.index(name) for name in names]
        return replace(
            self,
            prepared=tuple(self.prepared[t] for t in chosen),
            targets=tuple(self.targets[t] for t in chosen),
            stated_noise=None if self.stated_noise is None else self.stated_noise[chosen],
        )

    def of(self, trials: tuple[PreparedTrial, ...]) -> MotorProblem:
        """Return the problem of other trials, without their starts from rest.

        Their dead band is not known before the dynamic fit; L and the delay would make up for a wrong one.
        """
        return replace(self, prepared=trials, targets=tuple(trial.dynamic_target for trial in trials))

    @property
    def fitted(self) -> MotorProblem:
        """The trials of the dynamic fit, without their starts from rest."""
        return self.of(self.bench.fitted)

    @cached_property
    def pieces(self) -> tuple[tuple[str, ...], IntArray]:
        """What a ladder leaves out in turn: a few commands of a trial with what follows them."""
        most, found = max(1, _PIECES // len(self.prepared)), {}
        names: list[str] = []
        for t, (prepared, trial) in enumerate(zip(self.prepared, self.trials, strict=True)):
            steps = prepared.log.steps.time
            inside = steps[(steps > trial.time[0]) & (steps < trial.time[-1])]
            cuts = inside[[part[0] for part in np.array_split(np.arange(len(inside)), most) if len(part)][1:]]
            part = np.searchsorted(cuts, trial.time, side="right")
            found[t] = len(names) + part
            names += [f"{trial.name} from {time:.2f} s" for time in (trial.time[0], *cuts)]
        return tuple(names), np.concatenate([found[block.trial] for block in self.blocks])

    @property
    def one_constant(self) -> bool:
        """Whether k_m is k_v, because both are stated by one Kv or current with an error."""
        chosen = {*self.space.names, *self.campaign.parameters.fixed}
        return {*CONSTANTS} & chosen == {"back_emf_constant"} <= {*self.space.stated}

    def at_stated_scale(self, cube: FloatArray) -> FloatArray:
        """Return points with k as stated: torque and speed do not determine the scale of k², R and L."""
        space, scaled = self.space, ["winding_resistance", "winding_inductance"]
        if not self.one_constant or not {*scaled} <= {row.name for row in space.found}:
            return cube
        values = space.decode(cube)
        constant = space.names.index("back_emf_constant")
        stated = float(space.stated["back_emf_constant"])
        values[:, [space.names.index(name) for name in scaled]] *= (stated / values[:, [constant]]) ** 2
        values[:, constant] = stated
        return np.clip(space.encode(values), 0.0, 1.0)

    # --- scores and signals ---------------------------------------------------------------------------------

    def complete(self, rows: FloatArray) -> FloatArray:
        """Return rows (P, n_table) [SI] with all that follows from other values of theirs.

        No-load lines follow R, k_d and V_ref, measured curves their rows and their load cell, and k_m a k_v
        of the same source.
        """
        rows = np.array(rows, dtype=np.float64)
        if self.one_constant:
            rows[:, _INDEX["torque_constant"]] = rows[:, _INDEX["back_emf_constant"]]
        table, lift, cell = self.space.table, np.ones(len(rows)), self._cell(rows, LOAD_CELLS[0])
        if table.group(MEASURED_CURVE) and rows.shape[1] == len(table):
            if self.bench.volts:
                voltage = rows[:, _INDEX["reference_voltage"]]
                lift = (voltage / self.bench.values["reference_voltage"]) ** self.bench.volts
            for curve in self._own_curves:
                coefficients = np.array([curve.fit.coefficients])
                if curve.rows[0].name in table:
                    shares = rows[:, [table.index[row.name] for row in curve.rows]] - 1.0
                    # No matrix product: BLAS rounds a row by the number of its neighbours.
                    coefficients = coefficients + sum(shares[:, [i]] * c for i, c in enumerate(curve.changes))
                factor = lift if curve.fit.quantity == "no_load" else cell
                rows[:, [_INDEX[name] for name in curve.fit.parameters]] = coefficients * factor[:, None]
        column = {name: rows[:, i] for name, i in _INDEX.items()}
        scale = column["torque_constant"] * column["back_emf_constant"]
        drop, sag = column["winding_resistance"] / scale, column["supply_resistance"] / scale
        for direction, tie in self.ties.items():
            # The drags of the points are of the static logs; k_d is no torque of their load cell.
            line = tie.line(drop * cell, column["viscous_damping"] / cell, sag * cell)
            rows[:, [_INDEX[name] for name in no_load_line(direction)]] = line * lift[:, None]
        return rows

    def _cell(self, rows: FloatArray, cell: Parameter) -> FloatArray:
        """Return the factor (P,) [1] on the torque of a load cell; 1 where it is taken as exact."""
        place = self.space.table.index.get(cell.name, rows.shape[1])
        return rows[:, place].copy() if place < rows.shape[1] else np.ones(len(rows))

    @cached_property
    def _own_curves(self) -> tuple[MeasuredCurve, ...]:
        """Measured curves that the campaign neither fixes nor frees."""
        chosen = {*self.campaign.parameters.fixed, *(self.campaign.parameters.free or ())}
        return tuple(each for each in self.bench.measured_curves if not {*each.fit.parameters} & chosen)

    def score(self, rows: FloatArray) -> Scores:
        """Simulate and score rows (P, n_table) [SI]; rows of the model's table alone have one delay."""
        rows, scored = self.complete(rows), []
        for chosen in self.parts(len(rows)):
            part = rows[chosen]
            samples, reached, status = self.simulate(part)
            by_channel, failed = self.cost(samples, reached, self.sensors(part), self.threads)
            scored.append(Scores(by_channel, _causes(failed, status)))
        return Scores.joined(scored)

    def parts(self, count: int) -> list[slice]:
        """Return the parts in which candidates are simulated, one candidate per thread or more."""
        threads = threads_for(count, self.threads)
        share = max(threads, int(threads * _MEMORY / (16 * self.jobs.time.size)))
        return [slice(first, min(first + share, count)) for first in range(0, count, share)]

    def nrmse(self, rows: FloatArray) -> FloatArray:
        """Return the mean NRMSE (P,) of rows (P, n_table) [SI]."""
        return self.cost.mean(self.score(rows).by_channel)

    def nrmse_with(self, row: FloatArray, **values: FloatArray) -> FloatArray:
        """Return the NRMSE (P,) of a row (n_table,) with other values (P,) of some parameters [SI]."""
        rows = np.repeat(row[None], len(next(iter(values.values()))), axis=0)
        for name, column in values.items():
            rows[:, self.space.table.index[name]] = column
        return self.nrmse(rows)

    def predict(self, rows: FloatArray) -> Prediction:
        """Return scores and signals of rows (P, n_table) [SI], simulated once."""
        rows = self.complete(rows)
        samples, reached, status = self.simulate(rows)
        by_channel, failed, signals = self.cost.compared(samples, reached, self.sensors(rows), self.threads)
        return Prediction(by_channel, _causes(failed, status), signals)

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return samples (P, n_total, 2) [SI] on the trials' grids, share reached [1] and status (P, T)."""
        tell_of_kernel("the motor's kernels")
        runs = simulate_population(
            rows[:, : len(PARAMETERS)], self.jobs, delays=shifts(self.space.table, rows, self.prepared),
            drags=self._cell(rows, LOAD_CELLS[0]), tolerance=FIT_TOLERANCE, threads=self.threads,
            ideal_reversal=self.ideal_reversal,
        )  # fmt: skip
        # The trials are compared as their load cell shows them.
        runs.outputs[:, :, 0] /= self._cell(rows, LOAD_CELLS[1])[:, None]
        # Success is a status, not a share that rounding could leave at 1 - 1e-16.
        reached = np.where(runs.status == 0, 1.0, np.minimum(runs.reached, 1.0 - 1e-9))
        return runs.outputs, reached, runs.status

    def sensors(self, rows: FloatArray) -> FloatArray:
        """Return torque delay, torque lag and speed lag (P, 3) [s] of rows."""
        index = self.space.table.index
        return np.ascontiguousarray(rows[:, [index[name] for name in SENSORS]])

    # --- what is uncertain ----------------------------------------------------------------------------------

    @cached_property
    def noise(self) -> FloatArray:
        """(T, 2) standard deviation of the sensors' noise as compared [channel units]; NaN: none shows.

        While the rotor stands, a sensor may have less noise or none. White noise that has passed the filter
        of a fast log leaves less there, too, by what the filter's taps say.
        """
        if self.stated_noise is not None:
            return self.stated_noise
        out = np.full((len(self.targets), len(CHANNELS)), np.nan)
        for t, target in enumerate(self.targets):
            share = filtered_correlation(target, 3)
            gain = 20.0 * share[0] - 30.0 * share[1] + 12.0 * share[2] - 2.0 * share[3]
            turns = turning_instants(target)
            for c in range(len(CHANNELS)):
                out[t, c] = shown_noise(target.measured[target.valid[:, c] & turns, c], gain)
        return out

    def correlation(self) -> NoiseModel:
        """Return the correlations of sensor noise as compared: what the filter of fast logs leaves."""
        channels = tuple(sorted({block.channel for block in self.blocks}))
        shortest = min(len(target.time) for target in self.targets)
        lags = max(1, min(20, shortest // 3))
        # The widest: logs of two kinds in one campaign are rare, and white noise hardly changes by it.
        every = (filtered_correlation(target, lags) for target in self.targets)
        widest = max(every, key=lambda row: float(row.sum()))
        return NoiseModel(channels, np.eye(len(channels))[:, :, None] * widest)

    def disturbances_at(self, row: FloatArray) -> FloatArray:
        """Return how one standard deviation of what the fit takes as known moves the residuals (K, m) [1].

        The tare of every trial's torque, static curves, values that the campaign states within a range.
        """
        moved = np.zeros((0, self.blocks[-1].stop))
        for block in self.blocks:
            tare = self.prepared[block.trial].log.tares.get("torque")
            if block.channel == 0 and tare is not None and np.isfinite(tare.error):
                change = np.zeros((1, self.blocks[-1].stop))
                valid = self.targets[block.trial].valid[:, 0]
                change[0, block.start : block.stop] = valid * tare.error / block.spread
                moved = np.concatenate([moved, change])
        if len(self._changes):
            values, _ = self.compared(np.concatenate([row + self._changes, row - self._changes]))
            up, down = np.split(values[:, : moved.shape[1]], 2)
            moved = np.concatenate([moved, (up - down) / 2])
        return moved

    @property
    def common(self) -> int:
        """Number of static curves and stated ranges among the disturbances."""
        return len(self._changes)

    @cached_property
    def _changes(self) -> FloatArray:
        """(K, n_table) one standard deviation of each static curve and each stated range [SI]."""
        index, fixed, searched = self.space.table.index, self.campaign.parameters.fixed, self.space.names
        rows = {*self.space.table.group(MEASURED_CURVE)}
        moved = [
            curve.fit for curve in self.bench.measured_curves if {row.name for row in curve.rows} <= rows
        ]
        changes: list[FloatArray] = []

        def change(names: Sequence[str], size: ArrayLike) -> None:
            row = np.zeros(len(index))
            row[[index[name] for name in names]] = size
            changes.append(row)

        for fit in self.bench.curves.fits:
            names = [name for name in fit.parameters if name in index]
            # Curves that the campaign states are no fit to points.
            if fit.quantity == "thrust" or len(names) != 2 or {*fit.parameters} & {*fixed, *searched}:
                continue
            if any(fit is each for each in moved):
                continue
            first, second = fit.standard_errors
            rho = fit.correlation
            for root in ((first, rho * second), (0.0, np.sqrt(1 - rho**2) * second)):
                if np.isfinite(root).all():
                    change(names, root)
        # A range is a uniform density; both constants move together.
        stated = self.campaign.parameters.measured_ranges(PARAMETERS).items()
        ranges = {name: high - low for name, (low, high) in stated if name not in searched}
        constants = [ranges.pop(name) for name in CONSTANTS if name in ranges]
        if constants and not {*CONSTANTS} & {*searched} and max(constants) > 0:
            change(CONSTANTS, max(constants) / np.sqrt(12.0))
        for name, width in ranges.items():
            if name in index and width > 0:
                change([name], width / np.sqrt(12.0))
        return np.array(changes).reshape(len(changes), len(index))

    def floors(self, row: FloatArray) -> FloatArray:
        """Return the NRMSE (B,) that noise and errors of the measured inputs cost every block [1].

        The noise as compared, and one standard deviation of each static curve, tare and stated range: no
        dynamic parameter can take those away.
        """
        moved = self.disturbances_at(row)
        known = np.array([np.sum(moved[:, b.start : b.stop] ** 2) / b.count for b in self.blocks])
        noise = np.array([block.noise for block in self.blocks])
        return np.asarray(np.sqrt(noise**2 + known))

    def phases(self, trial: int, row: FloatArray) -> list[tuple[float, str]]:
        """Return what follows each command for 0.3 s, and the rest."""
        out = [(-np.inf, "at a constant command")]
        times = self.prepared[trial].log.steps.time
        for k, time in enumerate(times):
            out.append((float(time), "after a command"))
            if k + 1 == len(times) or times[k + 1] > time + _FOLLOWS:
                out.append((float(time) + _FOLLOWS, "at a constant command"))
        return out

    # --- what else a campaign says -------------------------------------------------------------

    @property
    def stated(self) -> Mapping[str, float]:
        """What the campaign and its static logs give."""
        return self.bench.values

    @property
    def mistakes(self) -> Iterator[tuple[Swap, SearchSpace]]:
        """Wrong numbers of poles, unless a log says that an optical probe counted the turns.

        They leave torques and voltages as they are, so an inertia that is stated rightly looks wrong.
        """
        inertia = self.space.stated.get("rotor_inertia")
        recorded = (trial.log.recording.provenance.notes for trial in self.prepared)
        notes = chain.from_iterable([*(log.notes for log in self.bench.curves.logs), *recorded])
        if inertia is None or any(note.code == "optical-speed" for note in notes):
            return
        for words, factor in _WRONG_POLES.items():
            title = f"all speeds {factor:.4g} times as high ({words})"
            read = Stated(factor * inertia, factor * inertia.error, inertia.assumed)
            where = "the poles in the stand's program, and export the logs anew"
            yield Swap(title, where=where), self.space.restating({"rotor_inertia": read})

    def known(self, fit: FitResult) -> Collection[str]:
        """Return what the campaign gives that is no guess; without k where the fit has identified R."""
        known = {*self.bench.values, *self.campaign.parameters.fixed} - self.bench.guessed
        if any(r.name == "winding_resistance" and r.status == "free" for r in fit.parameters):
            known -= {*CONSTANTS}
        if self._of_stand:
            seen = {log.get("sha256") for log in fit.provenance.get("logs", {}).values()}
            same = any(log.provenance["sha256"] in seen for log in self.bench.curves.logs)
            moved = {record.name for record in fit.parameters if record.status == "stated"}
            known = known - (self._of_stand & moved) if same else known | self._of_stand
        return known

    @property
    def _of_stand(self) -> set[str]:
        """Stated values of the static logs: rows of their curves, their load cell, and the supply."""
        own = {"reference_voltage", LOAD_CELLS[0].name, *self.space.table.group(MEASURED_CURVE)}
        return own & {*self.space.stated}

    @property
    def instruments(self) -> Collection[str]:
        """Delays and lags, static curves and their supply."""
        return (*(name for name in self.space.table if name in _INSTRUMENTS), *self._of_stand)

    @property
    def row_logs(self) -> Mapping[str, str]:
        """SHA-256 of the log of every delay, by the name of its row."""
        return {delay_name(trial.entry.log): str(trial.provenance["sha256"]) for trial in self.bench.trials}

    def completed(self, rows: FloatArray, fit: FitResult) -> FloatArray:
        """Return adopted rows (S, n_table) [SI] with delays of logs new to the fit, and no-load lines."""
        index = self.space.table.index
        fitted = {trial.name for trial in fit.trials if trial.use == "fit"}
        seen = {log.get("sha256") for name, log in fit.provenance.get("logs", {}).items() if name in fitted}
        recorded = {record.name for record in fit.parameters}
        for name, digest in self.row_logs.items():
            if name in index and not (digest in seen and name in recorded):
                rows[:, index[name]] = rows[:, index["command_delay"]]
        return self.complete(rows)


def _causes(failed: BoolArray, status: IntArray) -> NDArray[np.int8]:
    """Return why trials (P, T) failed; one that ran to its end failed for an NRMSE that is not finite."""
    return np.where(failed, np.where(status > 0, status, kernel.NOT_FINITE), 0).astype(np.int8)


def turning_instants(target: MotorTarget) -> BoolArray:
    """Return True (n,) where the rotor does not stand, as far as the speed shows it."""
    speed = np.where(target.valid[:, 1], np.abs(target.measured[:, 1]), np.nan)
    seen = np.isfinite(speed)
    if not seen.any():
        return np.ones(len(speed), dtype=np.bool_)
    near = np.interp(target.time, target.time[seen], speed[seen])
    return np.asarray(near > STANDS * np.max(near), dtype=np.bool_)


def filtered_correlation(target: MotorTarget, lags: int) -> FloatArray:
    """Return the correlation (lags + 1,) of white noise as compared, by samples apart [1]."""
    out = np.zeros(lags + 1)
    out[0] = 1.0
    if len(target.taps):
        stride = round(float(np.median(np.diff(target.time))) / target.grid_step)
        whole = np.concatenate([target.taps[:0:-1], target.taps])
        overlap = np.correlate(whole, whole, "full")[len(whole) - 1 :: stride][: lags + 1]
        out[: len(overlap)] = overlap / overlap[0]
    return out
