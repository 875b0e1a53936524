"""The drops of a campaign as a fit problem: searched, scored, differentiated, predicted.

A drop is lost where its simulation fails, which has scored a penalty already (`sysid.fit.nrmse`). Two more
kinds run to the end but describe no drop that was measured: no foot ever touches, or the body slides off the
board. Both keep their NRMSE, on a surface that goes on for ever, and pay `FAILED_NRMSE` for the share of the
window that is missing: a candidate that comes nearer to the board, or leaves it later, scores less, and one
that just reaches the board's end pays nothing.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign
from sysid.campaign.swaps import Swap
from sysid.errors import CampaignError
from sysid.fit.compiling import tell_of_kernel
from sysid.fit.nrmse import FAILED_NRMSE, FilteredNrmse
from sysid.fit.problem import Problem
from sysid.fit.result import FitResult
from sysid.fit.trial import Block, NoiseModel, Prediction, Scores, Trial
from sysid.gear.drops import PreparedDrop, cost_channels
from sysid.gear.model import (
    PARAMETERS,
    SURFACES,
    Drops,
    PopulationSamples,
    Simulation,
    Status,
    find_surface,
    parameters_on,
    prepare,
    simulate_population,
)
from sysid.gear.parameters import CAPTURED
from sysid.gear.starts import compared_noise, level_error, noise_signals, start_roots
from sysid.gear.stated import SLOPE, Moved, places_apart, with_stated, without_mistake
from sysid.gear.swaps import swaps
from sysid.journal import Finding
from sysid.parameters import SearchSpace
from sysid.trust.linearized import noise_model
from sysid.types import FloatArray

# Bound of the integration's error per step [1] in the simulations of the trust analysis: at 3e-4, with which
# low-friction drops are fitted, the error moves a sum of squares by as much as one standard deviation of a
# parameter does.
TRUST_TOLERANCE = 2e-5
# Least time between two touchdowns of one foot that count as two [s].
ONE_TOUCHDOWN = 5e-3
# Largest acceleration by forces other than the weight at which a body falls [m/s²].
_FALLING = 1.5
# Largest speed [m/s] and pitch rate [rad/s] of a body at rest.
_AT_REST = (0.1, 0.2)
# Rows that are choices of the model rather than measurements.
CONSTANTS = ("gravity", "leg_mass_fraction", "slip_regularization", *PARAMETERS.group("front leg", "term"))
# Rows on which no drop depends: motors do not run in one.
NEVER_IN_DROPS = ("thrust_point_dx",)
# Causes of a lost drop, in the order in which a candidate with several of them is counted. Too expensive: a
# contact or leg that is too stiff, or (on high friction mostly) too many bounces and mode switches.
CAUSES = ("diverged", "too_expensive", "step_collapsed", "never_touched", "left_the_board")
_OF_STATUS = {Status.BLEW_UP: 1, Status.TOO_EXPENSIVE: 2, Status.STEP_COLLAPSED: 3}
_NEVER_TOUCHED, _LEFT_BOARD = 4, 5
# Way from the touchdown, in lengths of the board, beyond which a body has left it: where the window ends, a
# candidate near the truth may cross the board's end a little before the measured body does.
_BEYOND_BOARD = 1.05


# Ways by which each stated height moves the feet as one metre more of foot_dz does [m].
_HEIGHTS = {"foot_dz": 1.0, "surface_dz": 1.0, "centre_of_mass_dz": -1.0}


@cache
def prepare_kernel(law: str) -> None:
    """Compile or load a law's kernel, once per process, and say so before: it may take a minute."""
    tell_of_kernel(f"the kernel of friction law {law}")
    prepare(law)


def gear_space(campaign: GearCampaign, drops: Sequence[PreparedDrop] = ()) -> SearchSpace:
    """Return the free parameters of a campaign and the values of all others.

    Where the `drops` were read with another height, or with other slopes, the search starts there.

    Raises CampaignError for an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a
    measured value, and a free parameter on which no drop depends.
    """
    law = find_surface(campaign.surface.law).name
    known = measured_values(campaign)
    space = campaign.parameters.search_space(parameters_on(law, known), SURFACES[law].free, known)
    unread = {*NEVER_IN_DROPS, *read_by_laws()}.difference(SURFACES[law].reads)
    for name in space.names:
        if name in unread:
            raise CampaignError(
                f"parameters.free: nothing in a drop on surface.law {law!r} depends on {name}; remove it "
                "from the list"
            )
    space = with_stated(space, campaign, drops)
    if drops:
        slopes = {drop.name: drop.slope for drop in drops}
        for name, value in _starts(campaign, space, drops[0].feet.dz, slopes).items():
            space = space.starting(name, value)
    return space


def reaches(campaign: GearCampaign, space: SearchSpace, other: GearCampaign) -> bool:
    """Return whether a fit in the space of a campaign can start at another height or at other slopes."""
    rows = {row.name: row for row in space.free if row.name in space.stated}
    slopes = {trial.name: trial.slope for trial in other.trials if trial.use == "fit"}
    starts = _starts(campaign, space, other.vehicle.foot_dz, slopes)
    return all(name in rows and rows[name].lower <= at <= rows[name].upper for name, at in starts.items())


def _starts(
    campaign: GearCampaign, space: SearchSpace, foot_dz: float, slopes: Mapping[str, float | None]
) -> dict[str, float]:
    """Return where stated rows start if drops are read with another foot_dz and other `slopes` [SI].

    Among feet, surface and centre of mass, the height with the largest stated error moves.
    """
    stated = {trial.name: trial.slope for trial in campaign.trials}
    starts = {
        f"{SLOPE.name}[{name}]": slope
        for name, slope in slopes.items()
        if slope is not None and slope != stated[name]
    }
    moved = foot_dz - campaign.vehicle.foot_dz
    if moved:
        errors = {name: space.stated[name].error for name in _HEIGHTS if name in space.stated}
        worst = max(errors, key=lambda name: errors[name], default="foot_dz")
        starts[worst] = space.stated.get(worst, campaign.vehicle.foot_dz) + _HEIGHTS[worst] * moved
    return starts


def read_by_laws() -> set[str]:
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
    sentence = f"friction law {law}: ignoring {ignored}, which the campaign states for {campaign.surface.law}"
    findings = (Finding("other-law", sentence),) if ignored else ()
    return campaign.model_copy(update=changed), findings


def fit_tolerance(campaign: GearCampaign) -> float:
    """Return the bound of the simulations' error per step that a campaign asks for."""
    stated = campaign.fit.tolerance
    return SURFACES[campaign.surface.law].tolerance if stated is None else stated


def measured_values(campaign: GearCampaign) -> dict[str, float]:
    """Return what the campaign states of the model's parameters, by name [SI]; defaults are not measured."""
    stated: dict[str, float] = {}
    for table in (campaign.vehicle, campaign.surface):
        stated |= table.model_dump(exclude_unset=True, exclude_none=True)
    return {name: stated[name] for name in PARAMETERS if name in stated}


@lru_cache(maxsize=8)
def _correlation(drop: PreparedDrop, channels: tuple[int, ...]) -> NoiseModel:
    """Return the correlations of the noise of a drop as compared."""
    signals = noise_signals(drop)
    n = len(signals)
    blocks = [Block(0, c, k * n, (k + 1) * n, n, 1.0, 1.0, 1.0) for k, c in enumerate(channels)]
    return noise_model(blocks, np.concatenate([signals[:, c] for c in channels]))


@dataclass(frozen=True, eq=False)
class GearProblem(Problem):
    """Drops of one campaign under one friction law; see `sysid.fit.problem.Problem`.

    The numbers do not depend on the threads (all cores by default).
    """

    campaign: GearCampaign
    space: SearchSpace
    drops: tuple[PreparedDrop, ...]
    threads: int | None = None
    # Bound of the simulation's error per step (`sysid.gear.model.simulate`); None: the campaign's.
    tolerance: float | None = None
    causes = CAUSES

    def __post_init__(self) -> None:
        if self.tolerance is None:
            object.__setattr__(self, "tolerance", fit_tolerance(self.campaign))

    def __getstate__(self) -> dict[str, Any]:
        # The search needs no logs, and their samples would travel to every worker.
        drops = tuple(replace(drop, recording=None) for drop in self.drops)
        return super().__getstate__() | {"drops": drops}

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

    def only(self, names: Sequence[str]) -> GearProblem:
        """Return the problem of some of the drops, in the order of their `names`."""
        drops = {drop.name: drop for drop in self.drops}
        return replace(self, drops=tuple(drops[name] for name in names))

    @property
    def with_rows_of_all(self) -> GearProblem:
        """The problem in which slope, release and place of every drop are rows."""
        trials = tuple(trial.model_copy(update={"use": "fit"}) for trial in self.campaign.trials)
        campaign = self.campaign.model_copy(update={"trials": trials})
        return replace(self, campaign=campaign, space=gear_space(campaign, self.drops))

    @property
    def exact(self) -> GearProblem:
        """The problem at the accuracy of trust, or finer."""
        return replace(self, tolerance=min(TRUST_TOLERANCE, fit_tolerance(self.campaign)))

    # --- scores and signals ---------------------------------------------------------------------------------

    def score(self, rows: FloatArray) -> Scores:
        """Simulate and score rows of the parameter table (P, n_table) [SI]."""
        parts = (self.simulate(rows[part]) for part in self.parts(len(rows)))
        return Scores.joined([self.judge_samples(*simulated) for simulated in parts])

    def judge_samples(self, samples: FloatArray, result: PopulationSamples) -> Scores:
        """Score what `simulate` returned, with all penalties."""
        by_channel, failed = self.cost(samples, result.reached, self.threads)
        cause = np.zeros(failed.shape, dtype=np.int8)
        for status, number in _OF_STATUS.items():
            cause[failed & (result.status == status)] = number
        # A share below 1 without a status is a trajectory that is not finite.
        cause[failed & (cause == 0)] = _OF_STATUS[Status.STEP_COLLAPSED]
        missing = np.zeros(failed.shape)
        touches = np.isfinite(result.first_contact).any(axis=2)
        missing[~touches] = 1.0
        cause[(cause == 0) & ~touches] = _NEVER_TOUCHED
        board_length = self.campaign.surface.board_length
        if board_length is not None:
            way = _BEYOND_BOARD * board_length
            feet = np.argmin(np.nan_to_num(result.first_contact, nan=np.inf), axis=2)
            for d, drop in enumerate(self.drops):
                first = int(self.cost.offsets[d]) + len(drop.before)
                # Two products beat the matrix product of a strided window.
                along = samples[:, first : first + len(drop.time), 0] * drop.feet.tangent[0]
                along += samples[:, first : first + len(drop.time), 1] * drop.feet.tangent[1]
                start = result.contact_state[np.arange(len(feet)), d, feet[:, d], :2] @ drop.feet.tangent
                beyond = along > (start + way)[:, None]
                share = np.where(beyond.any(axis=1), np.argmax(beyond, axis=1) / len(drop.time), 1.0)
                left = (cause[:, d] == 0) & (share < 1.0)
                missing[left, d] = 1.0 - share[left]
                cause[left, d] = _LEFT_BOARD
        # A failed simulation has scored its penalty.
        missing[failed] = 0.0
        return Scores(by_channel + FAILED_NRMSE * missing[:, :, None], cause)

    def simulate(
        self, rows: FloatArray, body_states: FloatArray | None = None
    ) -> tuple[FloatArray, PopulationSamples]:
        """Return samples (P, n_total, 6) [SI] with every drop's margins, and all that the simulation gives.

        `body_states` (P, D, 6) are starts of each candidate, instead of the measured ones.
        """
        prepare_kernel(self.campaign.surface.law)
        moved, slopes = Moved.of(self.space.table, rows, self.drops), None
        if moved is not None:
            if body_states is None:
                body_states = moved.released(self.drops)
            body_states, slopes = moved.starts(body_states), moved.slopes
        result = simulate_population(
            rows[:, : len(PARAMETERS)], self.jobs, body_states=body_states, slopes=slopes, **self.simulation
        )
        first, ends = self.cost.offsets, self.jobs.offset
        samples = np.empty((len(rows), self.cost.n_total, 6))
        for d, drop in enumerate(self.drops):
            lead = len(drop.before)
            before = drop.before if moved is None else moved.before(drop, d)
            samples[:, first[d] : first[d] + lead, :3] = before
            samples[:, first[d] : first[d] + lead, 3:] = np.nan
            samples[:, first[d] + lead : first[d + 1]] = result.samples[:, ends[d] : ends[d + 1]]
            if moved is not None:
                moved.as_captured(samples[:, first[d] + lead : first[d + 1]], d)
        return samples, result

    @property
    def simulation(self) -> Simulation:
        law = self.campaign.surface.law
        return {"surface": law, "tolerance": self.tolerance, "threads": self.threads}

    def predict(self, rows: FloatArray) -> Prediction:
        """Return scores and signals of rows (P, n_table) [SI], simulated once."""
        samples, result = self.simulate(rows)
        scored = self.judge_samples(samples, result)
        return Prediction(scored.by_channel, scored.cause, self.cost.prepared(samples))

    # --- what is uncertain ----------------------------------------------------------------------------------

    @cached_property
    def noise(self) -> FloatArray:
        """(D, 5) standard deviation of the capture's noise as compared [channel units]."""
        return np.array([compared_noise(drop) for drop in self.drops])

    def correlation(self) -> NoiseModel:
        """Return the correlations of the noise as compared, from noise that is filtered like a log."""
        model = _correlation(self.drops[0], tuple(sorted({block.channel for block in self.blocks})))
        shortest = min(block.stop - block.start for block in self.blocks)
        return NoiseModel(model.channels, model.covariance[:, :, : max(2, shortest // 3)])

    def disturbances_at(self, row: FloatArray) -> FloatArray:
        """Return how one standard deviation of every drop's start moves the residuals (K, m) [1]."""
        rows = row[None]
        moved = Moved.of(self.space.table, rows, self.drops)
        nominal = self.jobs.body_state[None] if moved is None else moved.released(self.drops)
        roots = [start_roots(drop) for drop in self.drops]
        kinds = len(roots[0])
        states = np.repeat(nominal, 2 * kinds, axis=0)
        for d, root in enumerate(roots):
            states[:kinds, d] += root
            states[kinds:, d] -= root
        samples, _ = self.simulate(np.repeat(rows, 2 * kinds, axis=0), states)
        signals = self.cost.prepared(samples)
        out = np.zeros((kinds * len(self.drops), self.blocks[-1].stop))
        for block in self.blocks:
            up, down = np.split(np.nan_to_num(signals[block.trial][:, :, block.channel]), 2)
            change = (up - down) / (2 * block.spread)
            if self.channels[block.channel] == "q_B":
                change[-1] = level_error(self.drops[block.trial]) / block.spread
            own = slice(block.trial * kinds, (block.trial + 1) * kinds)
            valid = self.trials[block.trial].valid[:, block.channel]
            out[own, block.start : block.stop] = np.where(valid, change, 0.0)
        return out

    # --- what else a campaign says --------------------------------------------------------------

    @property
    def stated(self) -> Mapping[str, float]:
        """What the campaign states of the model's parameters."""
        return measured_values(self.campaign)

    @property
    def mistakes(self) -> Iterator[tuple[Swap, SearchSpace]]:
        """Exchanges and lost signs."""
        for swap in swaps(self.campaign):
            yield swap, without_mistake(self.space, self.campaign, swap)

    @property
    def instruments(self) -> Collection[str]:
        """Places in the capture."""
        return CAPTURED

    def known(self, fit: FitResult) -> Collection[str]:
        """Return what the campaign states or fixes; places as well where no log is one of the fit's."""
        digests = {log.get("sha256") for log in fit.provenance.get("logs", {}).values()}
        new = digests.isdisjoint(trial.digest for trial in self.trials)
        return {*self.stated, *self.campaign.parameters.fixed, *(CAPTURED if new else ())}

    def shifts(self, fit: FitResult) -> Mapping[str, float]:
        """Return how far this campaign states places and tilt from where the fit's does."""
        text = fit.provenance.get("campaign", {}).get("text")
        if text is None:
            return {}
        return places_apart(self.campaign, GearCampaign.model_validate(tomllib.loads(text)))

    def phases(self, trial: int, row: FloatArray) -> list[tuple[float, str]]:
        """Return the fall, the contact until the body falls again, the bounces, and the rest.

        From the signals as compared: the filter rounds the instants by some 10 ms.
        """
        drop = self.only([self.drops[trial].name])
        time, down = self.drops[trial].time, self.drops[trial].touchdown
        _, _, rate_x, rate_z, pitch = drop.predict(row[None]).signals[0][0].T
        force = np.hypot(np.gradient(rate_x, time), np.gradient(rate_z, time) + self.campaign.vehicle.gravity)
        out = [(-np.inf, "before the first contact"), (down, "at the first contact")]
        falls = np.flatnonzero((time > down + ONE_TOUCHDOWN) & (force < _FALLING))
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
