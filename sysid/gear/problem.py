"""The drops of a campaign as a fit problem: searched, scored, differentiated, predicted."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import GearCampaign
from sysid.campaign.file import resolve_log
from sysid.errors import CampaignError
from sysid.fit.nrmse import FAILED_NRMSE, FilteredNrmse, PopulationCost
from sysid.fit.problem import Problem, tell_of_kernel
from sysid.fit.result import FitResult
from sysid.fit.trial import Block, NoiseModel, Prediction, Scores, Trial
from sysid.gear.beyond_window import centre_of_mass, stopping
from sysid.gear.drops import PreparedDrop, cost_channels, lowpass_of, read_drop_log
from sysid.gear.lost_drops import CAUSES, lost_drops
from sysid.gear.model import (
    LF_FREE,
    PARAMETERS,
    SURFACES,
    Drops,
    EventKind,
    PopulationSamples,
    find_surface,
    parameters_on,
    prepare,
    simulate,
    simulate_population,
)
from sysid.gear.plausible import notice_contradictions, notice_odd_vehicle
from sysid.gear.starts import (
    compared_noise,
    level_error,
    noise_signals,
    offsets,
    shifted_before,
    shifted_starts,
    start_roots,
    with_nuisance,
)
from sysid.journal import Finding, notice, tell
from sysid.parameters import SearchSpace
from sysid.trials.look import inspect_recording, log_quality
from sysid.trust.linearized import noise_model
from sysid.types import BoolArray, FloatArray

# Simulations of trust are this exact: at the fit's 3e-4 the integration's error moves a sum of squares by as
# much as one standard deviation of a parameter does.
TRUST_TOLERANCE = 2e-5
# Touchdowns of one foot closer than this count as one [s].
_ONE_TOUCHDOWN = 5e-3
# A body falls where forces other than its weight accelerate it less than this [m/s²]; it is at rest below
# this speed [m/s] and pitch rate [rad/s].
_FALLING, _AT_REST = 1.5, (0.1, 0.2)
# Rows that are choices of the model rather than measurements.
CONSTANTS = ("gravity", "leg_mass_fraction", "slip_regularization", *PARAMETERS.group("front leg", "term"))
# Motors do not run in a drop.
_NEVER_IN_DROPS = ("thrust_point_dx",)


@cache
def prepare_kernel(law: str) -> None:
    """Compile or load a law's kernel, once per process, and say so before: it may take a minute."""
    tell_of_kernel(f"the {law} kernel")
    prepare(law)


def gear_space(campaign: GearCampaign) -> SearchSpace:
    """Return the free parameters of a campaign and the values of all others.

    Raises CampaignError for an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a
    measured value, and a free parameter on which no drop depends.
    """
    law = find_surface(campaign.surface.law).name
    space = campaign.parameters.search_space(
        parameters_on(law), SURFACES[law].free, measured_values(campaign)
    )
    unread = {*_NEVER_IN_DROPS, *_read_by_laws()}.difference(SURFACES[law].reads)
    for name in space.names:
        if name in unread:
            raise CampaignError(
                f"parameters.free: nothing in a drop on surface.law {law!r} depends on {name}; remove it "
                "from the list"
            )
    return with_nuisance(space, campaign)


def _read_by_laws() -> set[str]:
    """Return the rows that any friction law reads."""
    return {name for law in SURFACES.values() for name in law.reads}


def on_surface(campaign: GearCampaign, law: str) -> tuple[GearCampaign, tuple[Finding, ...]]:
    """Return a campaign on another friction law, and a finding that names what it ignores.

    Friction that was measured or bounded on one surface says nothing of another: stated and fixed values,
    bounds and measured ranges of the campaign's surface are left out. Raises CampaignError for an unknown
    law.
    """
    find_surface(law)
    if law == campaign.surface.law:
        return campaign, ()
    of_surface = {name for name in type(campaign.surface).model_fields if name in PARAMETERS}
    choices = campaign.parameters
    tables = {
        table: {name: value for name, value in getattr(choices, table).items() if name not in of_surface}
        for table in ("bounds", "fixed", "measured")
    }
    stated = {name for table in tables for name in getattr(choices, table)} | set(measured_values(campaign))
    surface = campaign.surface.model_copy(update={**dict.fromkeys(of_surface), "law": law})
    changed = {"surface": surface, "parameters": choices.model_copy(update=tables)}
    ignored = ", ".join(name for name in PARAMETERS if name in stated & of_surface)
    sentence = f"surface {law}: ignoring {ignored}, which the campaign states for law {campaign.surface.law}"
    findings = (Finding("other-law", sentence),) if ignored else ()
    return campaign.model_copy(update=changed), findings


def fit_tolerance(campaign: GearCampaign) -> float:
    """Return the bound of the simulations' error per step that a campaign asks for."""
    stated = campaign.fit.tolerance
    return SURFACES[campaign.surface.law].tolerance if stated is None else stated


def measured_values(campaign: GearCampaign) -> dict[str, float]:
    """Return what the campaign states of the model's parameters, by name [SI]; defaults are not measured."""
    stated: dict[str, Any] = {}
    for table in (campaign.vehicle, campaign.surface):
        stated |= table.model_dump(exclude_unset=True, exclude_none=True)
    return {name: stated[name] for name in PARAMETERS if name in stated}


@dataclass(frozen=True, eq=False)
class GearProblem(Problem):
    """Drops of one campaign under one friction law; see `sysid.fit.problem.Problem`.

    The campaign's cost, surface and stated values count; the numbers do not depend on the threads (all cores
    by default). The tolerance, by default the campaign's, bounds the simulation's error per step
    (`sysid.gear.model.simulate`); the path is the campaign's file.
    """

    campaign: GearCampaign
    space: SearchSpace
    drops: tuple[PreparedDrop, ...]
    threads: int | None = None
    tolerance: float | None = None
    path: Path | None = None
    causes = CAUSES

    def __post_init__(self) -> None:
        if self.tolerance is None:
            object.__setattr__(self, "tolerance", fit_tolerance(self.campaign))

    @property
    def board_length(self) -> float | None:
        """Where the board ends, down-slope of the touchdown [m]; None: nowhere."""
        return self.campaign.surface.board_length

    # --- what is compared -----------------------------------------------------------------------------------

    @cached_property
    def trials(self) -> tuple[Trial, ...]:
        """The drops, counted from their first touchdown."""
        return tuple(
            Trial(
                drop.name, drop.use, drop.time, drop.target.measured,
                np.isfinite(drop.target.measured) & np.asarray(drop.target.valid, dtype=np.bool_)[:, None],
                drop.provenance, drop.touchdown, {"spectrum": drop.spectrum},
            )
            for drop in self.drops
        )  # fmt: skip

    @property
    def channels(self) -> tuple[str, ...]:
        """Position and its rate along x and z, and pitch."""
        return tuple(channel.name for channel in self.cost.channels)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the channels."""
        return tuple(channel.unit for channel in self.cost.channels)

    @cached_property
    def cost(self) -> FilteredNrmse:
        """The campaign's NRMSE over the drops."""
        targets = [drop.target for drop in self.drops]
        return FilteredNrmse(targets, cost_channels(self.campaign), self.campaign.cost.denominator)

    @cached_property
    def jobs(self) -> Drops:
        """What the kernel simulates."""
        return Drops(
            np.array([drop.slope for drop in self.drops]),
            np.array([drop.initial_state for drop in self.drops]),
            tuple(drop.simulated_time for drop in self.drops),
        )

    def only(self, names: Collection[str]) -> GearProblem:
        """Return the problem of some of the drops."""
        return replace(self, drops=tuple(drop for drop in self.drops if drop.name in names))

    @property
    def exact(self) -> GearProblem:
        """The problem at the accuracy of trust, or finer."""
        return replace(self, tolerance=min(TRUST_TOLERANCE, fit_tolerance(self.campaign)))

    # --- scores and signals ---------------------------------------------------------------------------------

    def score(self, rows: FloatArray) -> Scores:
        """Simulate and score rows of the parameter table (P, n_table) [SI]."""
        scored = [self.judge_samples(*self.simulate(rows[part])) for part in self._parts(len(rows))]
        return Scores(
            np.concatenate([part.by_channel for part, _ in scored]),
            np.concatenate([causes for _, causes in scored]),
        )

    def judge_samples(
        self, samples: FloatArray, result: PopulationSamples
    ) -> tuple[PopulationCost, NDArray[np.int8]]:
        """Score what `simulate` returned, with all penalties, and say of each drop (P, D) why it is lost."""
        scored = self.cost(samples, result.reached, self.threads)
        causes, missing = lost_drops(self.cost, self.drops, self.board_length, result, samples, scored.failed)
        by_channel = scored.by_channel + FAILED_NRMSE * missing[:, :, None]
        return PopulationCost(self.cost.mean(by_channel), by_channel, causes > 0), causes

    def simulate(
        self, rows: FloatArray, body_states: FloatArray | None = None
    ) -> tuple[FloatArray, PopulationSamples]:
        """Return samples (P, n_total, 6) [SI] with every drop's margins, and all that the simulation gives.

        `body_states` (P, D, 6) are starts of each candidate, instead of the measured ones.
        """
        prepare_kernel(self.campaign.surface.law)
        shift = offsets(self.space.table, rows, self.drops)
        if body_states is None and shift is not None:
            body_states = shifted_starts(self.drops, *shift)
        result = simulate_population(
            rows[:, : len(PARAMETERS)], self.jobs, body_states=body_states, **self._simulation
        )
        first, ends = self.cost.offsets, self.jobs.offset
        samples = np.empty((len(rows), self.cost.n_total, 6))
        for d, drop in enumerate(self.drops):
            lead = len(drop.before)
            before = drop.before if shift is None else shifted_before(drop, shift[1][:, d])
            samples[:, first[d] : first[d] + lead, :3] = before
            samples[:, first[d] : first[d] + lead, 3:] = np.nan
            samples[:, first[d] + lead : first[d + 1]] = result.samples[:, ends[d] : ends[d + 1]]
            if shift is not None:
                samples[:, first[d] + lead : first[d + 1], 1] += shift[0][:, d, None]
        return samples, result

    @property
    def _simulation(self) -> dict[str, Any]:
        law = self.campaign.surface.law
        return {"surface": law, "tolerance": self.tolerance, "threads": self.threads}

    def _lost(self, samples: FloatArray, result: PopulationSamples) -> BoolArray:
        """Return which drops (P, D) are lost, unscored."""
        failed = result.reached < 1.0
        return lost_drops(self.cost, self.drops, self.board_length, result, samples, failed)[0] > 0

    def signals(self, rows: FloatArray) -> tuple[tuple[FloatArray, ...], BoolArray]:
        """Return the signals as compared, (P, n, 5) [SI] per drop, and which drops are lost (P, D)."""
        samples, result = self.simulate(rows)
        return self.cost.prepared(samples), self._lost(samples, result)

    def predict(self, rows: FloatArray) -> Prediction:
        """Return scores and signals of rows (P, n_table) [SI], simulated once."""
        samples, result = self.simulate(rows)
        scored, causes = self.judge_samples(samples, result)
        return Prediction(scored.by_channel, causes, self.cost.prepared(samples))

    def compared(
        self, rows: FloatArray, body_states: FloatArray | None = None
    ) -> tuple[FloatArray, BoolArray]:
        """Return residuals and failures of rows (P, n_table) [SI], from starts (P, D, 6) where given."""
        compared = max(channel.column for channel in self.cost.channels) + 1
        samples = np.empty((len(rows), self.cost.n_total, compared))
        lost = np.empty(len(rows), dtype=np.bool_)
        for part in self._parts(len(rows)):
            every, result = self.simulate(rows[part], None if body_states is None else body_states[part])
            samples[part] = every[:, :, :compared]
            lost[part] = np.any(self._lost(every, result), axis=1)
        np.nan_to_num(samples, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        out = np.zeros((len(rows), self.blocks[-1].stop))
        for block in self.blocks:
            first, last = self.cost.offsets[block.trial], self.cost.offsets[block.trial + 1]
            column = self.cost.channels[block.channel].column
            # Of all rows at once: the last bit of a product depends on how many rows it has.
            signal = samples[:, first:last, column] @ self._operators[block.trial][block.channel].T
            trial = self.trials[block.trial]
            error = signal - trial.measured[:, block.channel]
            valid = trial.valid[:, block.channel]
            out[:, block.start : block.stop] = np.where(valid, error, 0.0) / block.spread
        return np.nan_to_num(out, copy=False), lost

    @property
    def samples(self) -> int:
        """Simulated numbers of one candidate, which bound how many are simulated at once."""
        return 6 * self.cost.n_total

    @cached_property
    def _operators(self) -> tuple[tuple[FloatArray, ...], ...]:
        """Filter and difference of every drop as matrices, which take a whole population at once."""
        return tuple(self.cost.operators(t) for t in range(len(self.drops)))

    # --- what is uncertain ----------------------------------------------------------------------------------

    @cached_property
    def noise(self) -> FloatArray:
        """(D, 5) standard deviation of the capture's noise as compared [channel units]."""
        return np.array([compared_noise(drop) for drop in self.drops])

    def correlation(self) -> NoiseModel:
        """Return the correlations of the noise as compared, from noise that is filtered like a log."""
        signals = noise_signals(self.drops[0])
        used = sorted({block.channel for block in self.blocks})
        n = len(signals)
        blocks = [Block(0, c, k * n, (k + 1) * n, n, 1.0, 1.0, 1.0) for k, c in enumerate(used)]
        model = noise_model(blocks, np.concatenate([signals[:, c] for c in used]))
        shortest = min(block.stop - block.start for block in self.blocks)
        return NoiseModel(model.channels, model.covariance[:, :, : max(2, shortest // 3)])

    def disturbances_at(self, row: FloatArray) -> FloatArray:
        """Return how one standard deviation of every drop's start moves the residuals (K, m) [1]."""
        rows = row[None]
        shift = offsets(self.space.table, rows, self.drops)
        nominal = np.array([[drop.initial_state for drop in self.drops]])
        if shift is not None:
            nominal = shifted_starts(self.drops, *shift)
        roots = [start_roots(drop) for drop in self.drops]
        kinds = len(roots[0])
        states = np.repeat(nominal, 2 * kinds, axis=0)
        for d, root in enumerate(roots):
            states[:kinds, d] += root
            states[kinds:, d] -= root
        values, _ = self.compared(np.repeat(rows, 2 * kinds, axis=0), states)
        change = (values[:kinds] - values[kinds:]) / 2
        for block in self.blocks:
            if self.channels[block.channel] == "q_B":
                valid = self.trials[block.trial].valid[:, block.channel]
                level = level_error(self.drops[block.trial])
                change[-1, block.start : block.stop] = valid * level / block.spread
        out = np.zeros((kinds * len(self.drops), values.shape[1]))
        for block in self.blocks:
            where = slice(block.start, block.stop)
            out[block.trial * kinds : (block.trial + 1) * kinds, where] = change[:, where]
        return out

    # --- what else a campaign says --------------------------------------------------------------

    def begin(self) -> None:
        """Tell what is fitted and what is not used, and compile the kernel."""
        self._notice_defaults()
        count = len(self.fitted.drops)
        validated, free = len(self.drops) - count, len(self.space.free)
        tell(f"{count} drops to fit, {validated} to validate; {free} free parameters")
        prepare_kernel(self.campaign.surface.law)

    def _notice_defaults(self) -> None:
        """Name stated values that are not used, and values of the paper's drone that stand in for others."""
        law, stated = self.campaign.surface.law, self.stated
        for name in self.space.names:
            if name in stated:
                notice(
                    "stated-and-free",
                    f"{name} is stated in the campaign and free on {law}: the search chooses it, the stated "
                    "value is not used; name it under [parameters.fixed] to keep it",
                )
        reads = find_surface(law).reads
        given = {*stated, *self.campaign.parameters.fixed, *CONSTANTS, *LF_FREE}
        left = [
            f"{name} {value:.4g} {PARAMETERS[name].unit}".removesuffix(" 1")
            for name, value in self.space.fixed.items()
            if name not in {*given, *_NEVER_IN_DROPS} and (name in reads or name not in _read_by_laws())
        ]
        if left:
            notice(
                "values-of-the-paper",
                f"not in the campaign, so the values of the paper's F450 are used: {', '.join(left)}; "
                "state your own",
            )
        for name in {*_NEVER_IN_DROPS} - given:
            value = f"{self.space.fixed[name]:.4g} {PARAMETERS[name].unit}"
            tell(f"{name}: the paper's {value}; no drop depends on it, only simulations with thrust do")

    @property
    def accuracy(self) -> Mapping[str, Any]:
        """The law and the tolerance."""
        law = self.campaign.surface.law
        return {"friction_law": law, "accuracy_of_a_simulation": self.tolerance}

    @property
    def stated(self) -> Mapping[str, float]:
        """What the campaign states of the model's parameters."""
        return measured_values(self.campaign)

    def known(self, fit: FitResult) -> Collection[str]:
        """Return what the campaign states or fixes."""
        return {*self.stated, *self.campaign.parameters.fixed}

    @property
    def filters(self) -> Mapping[str, Any]:
        """The low-pass at the rate of the first drop."""
        lowpass = lowpass_of(self.campaign, self.drops[0].motion.rate)
        if lowpass is None:
            return {"kind": "none"}
        return lowpass.design() | {"simulation_filtered": self.campaign.filter.filter_simulation}

    def contacts(self, trial: int, row: FloatArray) -> FloatArray:
        """Return when feet touch (k,) [s] in a prediction, on the drop's clock; within 5 ms: once."""
        drop = self.drops[trial]
        run = simulate(
            row[: len(PARAMETERS)], drop.slope, drop.initial_state, drop.simulated_time,
            surface=self.campaign.surface.law, tolerance=self.tolerance,
        )  # fmt: skip
        out: list[float] = []
        last: dict[str, float] = {}
        for event in run.events:
            if event.kind is EventKind.TOUCHDOWN:
                if event.time - last.get(event.foot, -1.0) > _ONE_TOUCHDOWN:
                    out.append(event.time)
                last[event.foot] = event.time
        return drop.time[0] + np.array(out)

    def phases(self, trial: int, row: FloatArray) -> list[tuple[float, str]]:
        """Return the fall, the contact until the body falls again, the bounces, and the rest.

        From the signals as compared: the filter rounds the instants by some 10 ms.
        """
        drop = self.only([self.drops[trial].name])
        time, down = self.drops[trial].time, self.drops[trial].touchdown
        _, _, rate_x, rate_z, pitch = drop.signals(row[None])[0][0][0].T
        force = np.hypot(np.gradient(rate_x, time), np.gradient(rate_z, time) + self.campaign.vehicle.gravity)
        out = [(-np.inf, "before the first contact"), (down, "at the first contact")]
        falls = np.flatnonzero((time > down + _ONE_TOUCHDOWN) & (force < _FALLING))
        hit = np.flatnonzero((time > down) & (force > _FALLING))
        falls = falls[falls > hit[0]] if len(hit) else falls[:0]
        if len(falls):
            out.append((float(time[falls[0]]), "between bounces"))
        moving = np.hypot(rate_x, rate_z) > _AT_REST[0]
        moving |= np.abs(np.gradient(pitch, time)) > _AT_REST[1]
        last = int(np.max(np.flatnonzero(moving), initial=0))
        if last + 1 < len(time) and time[last + 1] > out[-1][0]:
            out.append((float(time[last + 1]), "at rest"))
        return out

    def beyond(self, rows: FloatArray) -> list[dict[str, Any]]:
        """Return slope and resting place of every drop, over the sets and the starts' uncertainty.

        ``stop``: place [m, down-slope] and time [s] since the first touchdown, each measured, mean and sigma.
        """
        stops = [stopping(drop, rows, self.board_length, **self._simulation) for drop in self.drops]
        return [
            {"slope_deg": float(np.degrees(drop.slope)), "stop": stop}
            for drop, stop in zip(self.drops, stops, strict=True)
        ]

    def quality(self) -> list[dict[str, Any]]:
        """Return how good every log is, and how its fall begins and ends."""
        notice_odd_vehicle(self.campaign)
        return [self._quality(drop) for drop in self.drops]

    def _quality(self, drop: PreparedDrop) -> dict[str, Any]:
        assert self.path is not None
        campaign, flight, motion = self.campaign, drop.flight, drop.motion
        trial = next(entry for entry in campaign.trials if entry.name == drop.name)
        log = resolve_log(self.path, trial.log)
        recording = read_drop_log(campaign, log, trial.rigid_body, trial.log_options.model_dump_json())
        report = inspect_recording(recording, campaign.vehicle.gravity)
        notice_contradictions(campaign, trial, report.drop)
        window = (motion.time >= drop.time[0]) & (motion.time <= drop.time[-1])
        tilt = np.nanmax(np.abs([motion.roll[window], motion.yaw[window]]))
        stated = ("slope_deg", "release", "touchdown", "impact_speed", "notes")
        return {
            **log_quality(drop.name, drop.use, report),
            **{key: drop.provenance[key] for key in stated},
            "noise": dict(zip(("x", "z", "pitch"), flight.noise.tolist(), strict=True)),
            "gravity": flight.measured_gravity,
            "gravity_error": _fall_error(drop),
            "held": flight.held,
            "lost_in_window": int(np.sum(~motion.valid[window])),
            "out_of_plane_deg": float(np.degrees(tilt)),
        }

    def excitation(self) -> dict[str, Any]:
        """Return the ranges of slopes [deg], impact speeds [m/s] and largest pitch rates [rad/s]."""
        drops = self.fitted.drops
        rates = [np.gradient(drop.target.measured[:, 4], 1 / drop.motion.rate) for drop in drops]
        spans = {
            "slope_deg": [float(np.degrees(drop.slope)) for drop in drops],
            "impact_speed": [drop.impact_speed for drop in drops],
            "pitch_rate": [float(np.nanmax(np.abs(rate))) for rate in rates],
        }
        return {name: [min(values), max(values)] for name, values in spans.items()}

    def about(self) -> dict[str, Any]:
        """Return where the centre of mass is, seen from the stated one."""
        return {"centre_of_mass": centre_of_mass(self.drops, self.campaign)}


def _fall_error(drop: PreparedDrop) -> float:
    """Return the standard error of the g that the fall itself shows [m/s²].

    Of a parabola through n samples of noise σ over a time T: σ sqrt(720/n)/T².
    """
    lasts = drop.touchdown - drop.flight.start
    count = lasts * drop.motion.rate
    return float(drop.flight.noise[1] * np.sqrt(720.0 / count) / lasts**2) if count > 3 else np.nan
