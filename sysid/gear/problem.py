"""`fit-gear`: drops in, five ranked parameter sets out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import GearCampaign, read_campaign
from sysid.errors import CampaignError, SysidWarning
from sysid.filters import KaiserLowpass
from sysid.fit.history import summed
from sysid.fit.nrmse import FilteredNrmse, PopulationCost
from sysid.fit.objective import Evaluation
from sysid.fit.result import FitResult, TrialResult, ranked_sets
from sysid.gear.drop_offsets import offsets, shifted_before, shifted_starts, with_nuisance
from sysid.gear.drops import PreparedDrop, cost_channels, prepare_drops
from sysid.gear.lost_drops import CAUSES, first_cause, judged_drops
from sysid.gear.model import (
    LF_FREE,
    PARAMETERS,
    SURFACES,
    Drops,
    PopulationSamples,
    find_surface,
    parameters_on,
    prepare,
    simulate_population,
)
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.parameters import SearchSpace
from sysid.types import FloatArray
from sysid.workflows.fit import FitWalk, Outcome
from sysid.workflows.search import FitOptions


def search_space(campaign: GearCampaign) -> SearchSpace:
    """Return the free parameters of a campaign and the values of all others.

    Raises
    ------
    CampaignError
        For an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a measured value, and a
        free parameter that the drops do not depend on.
    """
    law = find_surface(campaign.surface.law).name
    space = campaign.parameters.search_space(
        parameters_on(law), SURFACES[law].free, measured_values(campaign)
    )
    unread = {*_NEVER_IN_DROPS, *_read_by_laws()}
    for name in space.names:
        if name in unread.difference(SURFACES[law].reads):
            raise CampaignError(
                f"parameters.free: nothing in a drop on surface.law {law!r} depends on {name}; remove it "
                "from the list"
            )
    return with_nuisance(space, campaign)


def _read_by_laws() -> set[str]:
    """Return the rows that friction laws read, whichever; a law does not depend on those of another."""
    return {name for own in SURFACES.values() for name in own.reads}


def on_surface(campaign: GearCampaign, law: str) -> tuple[GearCampaign, tuple[str, ...]]:
    """Return a campaign on another friction law, and the names of what it states of its own surface only.

    Friction that was measured or bounded on one surface says nothing of another: stated values, fixed ones,
    bounds and measured ranges of it are left out where the law differs from the campaign's.

    Raises
    ------
    CampaignError
        When there is no such law.
    """
    find_surface(law)
    if law == campaign.surface.law:
        return campaign, ()
    of_surface = {name for name in type(campaign.surface).model_fields if name in PARAMETERS}
    own = campaign.parameters
    tables = {
        table: {name: value for name, value in getattr(own, table).items() if name not in of_surface}
        for table in ("bounds", "fixed", "measured")
    }
    said = {name for table in tables for name in getattr(own, table)} | set(measured_values(campaign))
    nothing = dict.fromkeys(of_surface)
    surface = campaign.surface.model_copy(update={**nothing, "law": law})
    changed = {"surface": surface, "parameters": own.model_copy(update=tables)}
    return campaign.model_copy(update=changed), tuple(
        name for name in PARAMETERS if name in said & of_surface
    )


def say_dropped(campaign: GearCampaign, dropped: tuple[str, ...]) -> None:
    """Warn of what `on_surface` left out."""
    if dropped:
        warnings.warn(
            f"surface.law {campaign.surface.law} instead of the campaign's own: {', '.join(dropped)} stated "
            f"there {'is' if len(dropped) == 1 else 'are'} of the other surface and not used",
            SysidWarning,
            stacklevel=2,
        )


def fit_tolerance(campaign: GearCampaign) -> float:
    """Return the bound of the simulations' error per step that a campaign asks for."""
    own = campaign.fit.tolerance
    return SURFACES[campaign.surface.law].tolerance if own is None else own


def measured_values(campaign: GearCampaign) -> dict[str, float]:
    """Return what the campaign states of the model's parameters, by name [SI]; defaults are not measured."""
    stated = {
        **campaign.vehicle.model_dump(exclude_unset=True, exclude_none=True),
        **campaign.surface.model_dump(exclude_unset=True, exclude_none=True),
    }
    return {name: stated[name] for name in PARAMETERS if name in stated}


_DERIVED = (
    ParameterRecord(
        "leg_length", "l", "m", "derived", "Length of a leg at rest, joint to foot.", "Table II, note a"
    ),
    ParameterRecord(
        "leg_rest_angle",
        "q_n",
        "rad",
        "derived",
        "Angle of a leg from the body at rest, outward from straight down.",
        "Table II, note a",
    ),
)


def _derived(rows: FloatArray) -> FloatArray:
    """Return leg length and rest angle (S, 2) of rows of the parameter table (S, n_par)."""
    column = {name: rows[:, i] for i, name in enumerate(PARAMETERS)}
    across = column["foot_dx"] - column["joint_dx"]
    down = column["foot_dz"] - column["joint_dz"]
    return np.column_stack([np.hypot(across, down), np.arctan2(across, down)])


@dataclass(frozen=True, eq=False)
class GearObjective:
    """Mean NRMSE of a population over drops.

    Parameters
    ----------
    space : SearchSpace
        Free parameters and fixed values.
    drops : tuple of PreparedDrop
        What is compared.
    channels, denominator
        Of the cost.
    surface : str
        Friction law.
    threads : int, optional
        Cores to use; all by default. The numbers do not depend on it.
    tolerance : float, optional
        Bound of the simulation's error per step, the surface's own by default, see
        `sysid.gear.model.simulate`.
    board_length : float, optional
        Way down-slope from the touchdown to the board's end [m].
    """

    space: SearchSpace
    drops: tuple[PreparedDrop, ...]
    cost: FilteredNrmse
    surface: str
    threads: int | None = None
    tolerance: float | None = None
    board_length: float | None = None
    _jobs: Drops = field(init=False, repr=False)

    def __post_init__(self) -> None:
        jobs = Drops(
            np.array([drop.slope for drop in self.drops]),
            np.array([drop.initial_state for drop in self.drops]),
            tuple(drop.simulated_time for drop in self.drops),
        )
        object.__setattr__(self, "_jobs", jobs)

    @classmethod
    def build(
        cls,
        campaign: GearCampaign,
        space: SearchSpace,
        drops: tuple[PreparedDrop, ...],
        threads: int | None = None,
        tolerance: float | None = None,
    ) -> GearObjective:
        """Join prepared drops with the campaign's cost; the tolerance is the campaign's by default."""
        cost = FilteredNrmse(
            [drop.target for drop in drops], cost_channels(campaign), campaign.cost.denominator
        )
        accuracy = fit_tolerance(campaign) if tolerance is None else tolerance
        return cls(space, drops, cost, campaign.surface.law, threads, accuracy, campaign.surface.board_length)

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes of failure that are told apart."""
        return CAUSES

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        scored, causes = self.judge(self.space.full(cube))
        return Evaluation(scored.cost, causes, len(cube) * len(self.drops))

    def score(self, rows: FloatArray) -> PopulationCost:
        """Simulate and score rows of the whole parameter table (P, n_par) [SI]."""
        return self.judge(rows)[0]

    def judge(self, rows: FloatArray) -> tuple[PopulationCost, NDArray[np.int8]]:
        """Score rows, and tell of each why it failed: the number (from 1) among `causes`, 0 for none."""
        scored, causes = self.judge_samples(*self.simulate(rows))
        return scored, first_cause(causes)

    def judge_samples(
        self, samples: FloatArray, result: PopulationSamples
    ) -> tuple[PopulationCost, NDArray[np.int8]]:
        """Score what `simulate` returned, and tell of each drop (P, D) why it is lost."""
        scored = self.cost(samples, result.reached, self.threads)
        return judged_drops(self.cost, self.drops, self.board_length, result, samples, scored)

    def simulate(
        self, rows: FloatArray, body_states: FloatArray | None = None
    ) -> tuple[FloatArray, PopulationSamples]:
        """Return samples (P, n_total, 6) with every drop's margins, and all that the simulation found.

        `body_states` (P, D, 6) are starts of each candidate's own, instead of the measured ones.
        """
        own = offsets(self.space.table, rows, self.drops)
        if body_states is None and own is not None:
            body_states = shifted_starts(self.drops, *own)
        result = simulate_population(
            rows[:, : len(PARAMETERS)],
            self._jobs,
            surface=self.surface,
            tolerance=self.tolerance,
            threads=self.threads,
            body_states=body_states,
        )
        first, ends = self.cost.offsets, self._jobs.offset
        samples = np.empty((len(rows), self.cost.n_total, 6))
        for d, drop in enumerate(self.drops):
            lead = len(drop.before)
            before = drop.before if own is None else shifted_before(drop, own[1][:, d])
            samples[:, first[d] : first[d] + lead, :3] = before
            samples[:, first[d] : first[d] + lead, 3:] = np.nan
            samples[:, first[d] + lead : first[d + 1]] = result.samples[:, ends[d] : ends[d + 1]]
            if own is not None:
                samples[:, first[d] + lead : first[d + 1], 1] += own[0][:, d, None]
        return samples, result


def fit_gear(
    path: str | Path,
    options: FitOptions | None = None,
    *,
    surface: str | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[FitResult, Path]:
    """Fit the landing gear to the drops of a campaign and write the fit folder.

    Parameters
    ----------
    path : str or Path
        Campaign file of kind ``gear``.
    options : FitOptions
        Overrides of the command line.
    surface : str, optional
        Overrides the campaign's friction law, as `on_surface` does.
    say : callable, optional
        Told, one sentence at a time, what is going on and what is doubtful.

    Returns
    -------
    result : FitResult
        Ranked sets and all that led to them.
    folder : Path
        Where it was written.

    Raises
    ------
    SysidError
        When an input cannot be used; nothing has been written then.
    """
    campaign = read_campaign(path, "gear")
    assert isinstance(campaign, GearCampaign)
    dropped: tuple[str, ...] = ()
    if surface is not None:
        campaign, dropped = on_surface(campaign, surface)
    with FitWalk(path, campaign, options, say) as walk:
        return _walked(walk, campaign, dropped)


def _walked(walk: FitWalk, campaign: GearCampaign, dropped: tuple[str, ...]) -> tuple[FitResult, Path]:
    """Walk a fit to its end."""
    path, threads = walk.path, walk.options.threads
    with walk.prepared():
        say_dropped(campaign, dropped)
        space = search_space(campaign)
        ranges = campaign.parameters.measured_ranges(PARAMETERS)
        _say_defaults(campaign, space)
        drops = prepare_drops(campaign, path)
        fitted = tuple(drop for drop in drops if drop.use == "fit")
        objective = GearObjective.build(campaign, space, fitted, threads)
        walk.tell(
            f"{len(fitted)} drops to fit, {len(drops) - len(fitted)} to validate; {len(space.free)} free "
            f"parameters"
        )
        law = campaign.surface.law
        walk.tell(f"preparing the {law} kernel: compiled once per version (under a minute), then loaded")
        prepare(law, single=False)
        expected = _expected(objective, walk.tell) if walk.options.check else {}
        hashes = {drop.name: str(drop.provenance["sha256"]) for drop in drops}
        accuracy = {"friction_law": law, "accuracy_of_a_simulation": objective.tolerance}
        found = walk.search(objective, hashes, "drops", **accuracy)
    sets = ranked_sets(found.runs, space)
    records = parameter_records(
        space,
        {name: "campaign" for name in measured_values(campaign) if name not in _CONSTANTS},
        ranges,
        _DERIVED,
        stated={name: "campaign" for name in {*measured_values(campaign), *campaign.parameters.fixed}},
    )
    trials, lost = trial_results(GearObjective.build(campaign, space, drops, threads), sets.values)
    outcome = Outcome(
        records=records,
        values=np.hstack([sets.values, _derived(sets.values)]),
        at_bound=np.pad(sets.at_bound, ((0, 0), (0, len(_DERIVED)))),
        nrmse=sets.cost,
        trials=trials,
        channels=[(channel.name, channel.unit, channel.weight) for channel in objective.cost.channels],
        settings=_settings(campaign, fitted),
        filters=_filter_design(campaign, fitted[0]),
        logs={drop.name: drop.provenance for drop in drops},
        warnings=lost,
        more={"failures": summed(run.failures for run in found.runs), **expected},
    )
    return walk.finish(space, found, sets, outcome)


def _expected(objective: GearObjective, tell: Callable[[str], None]) -> dict[str, Any]:
    """Say what the drops are expected to fix, and return it for the provenance."""
    # What judges an objective stands above it.
    from sysid.gear.trust import GearProblem
    from sysid.trust.verdicts import EXPECTED, sentences
    from sysid.workflows.check import quick_gear

    found = quick_gear(GearProblem(objective))
    for sentence in sentences(found):
        tell(f"expected: {sentence}")
    return {EXPECTED: [one.document() for one in found]}


# Rows that are choices of the model rather than measurements.
_CONSTANTS = (
    "gravity",
    "leg_mass_fraction",
    "slip_regularization",
    *PARAMETERS.group("front leg"),
)
# Motors do not run in a drop.
_NEVER_IN_DROPS = ("thrust_point_dx",)


def _say_defaults(campaign: GearCampaign, space: SearchSpace) -> None:
    """Warn of values left to the paper's drone, which another does not share, and of stated ones not used."""
    law = campaign.surface.law
    reads = find_surface(law).reads
    for name in space.names:
        if name in measured_values(campaign):
            warnings.warn(
                f"{name} is stated in the campaign and free on {law}: the search chooses it, the stated "
                f"value is not used; fix it under [parameters.fixed] to keep it",
                SysidWarning,
                stacklevel=2,
            )
    given = {*measured_values(campaign), *campaign.parameters.fixed, *_CONSTANTS, *LF_FREE}
    left = [
        f"{name} {value:.4g} {PARAMETERS[name].unit}".removesuffix(" 1")
        for name, value in space.fixed.items()
        if name not in given and (name in reads or name not in _read_by_laws())
    ]
    if left:
        warnings.warn(
            f"not in the campaign, so the values of the paper's F450 are used: {', '.join(left)}; "
            f"state your own",
            SysidWarning,
            stacklevel=2,
        )


def trial_results(
    objective: GearObjective, rows: FloatArray
) -> tuple[tuple[TrialResult, ...], tuple[str, ...]]:
    """Score the ranked sets (S, n_par) on every drop, and say of each lost one why.

    Returns
    -------
    trials : tuple of TrialResult
        One per drop.
    lost : tuple of str
        A sentence per drop and set whose simulation is no drop that can be compared.
    """
    samples, result = objective.simulate(rows)
    scored, causes = objective.judge_samples(samples, result)
    simulated = objective.cost.prepared(samples)
    out = []
    for d, drop in enumerate(objective.drops):
        measured = drop.target.measured
        valid = np.isfinite(measured)
        if drop.target.valid is not None:
            valid &= drop.target.valid[:, None]
        out.append(
            TrialResult(
                name=drop.name,
                use="fit" if drop.use == "fit" else "validate",
                time=drop.time,
                measured=measured,
                valid=valid,
                simulated=simulated[d],
                nrmse=scored.by_channel[:, d],
                spectrum=drop.spectrum,
            )
        )
    lost = tuple(
        f"{objective.drops[d].name}, set {s + 1}: {CAUSES[causes[s, d] - 1]}; its NRMSE is a penalty"
        for d, s in np.argwhere(causes.T > 0)
    )
    return tuple(out), lost


def _settings(campaign: GearCampaign, drops: tuple[PreparedDrop, ...]) -> dict[str, Any]:
    """Return what a simulator must know beside the numbers."""
    return {
        "surface": campaign.surface.law,
        "frame": (
            "x down-slope, z up, y into the page; positive pitch turns z toward x; a slope falls toward +x; "
            "rear leg up-slope at -x, front leg at +x; every leg value is of the pair at that end"
        ),
        "window": {
            "before_contact [s]": campaign.window.before_contact,
            "after_contact [s]": campaign.window.after_contact,
        },
        "slopes [deg]": {drop.name: float(np.degrees(drop.slope)) for drop in drops},
        "tolerance": fit_tolerance(campaign),
    }


def _filter_design(campaign: GearCampaign, drop: PreparedDrop) -> dict[str, Any]:
    settings = campaign.filter
    if settings.kind == "none":
        return {"kind": "none"}
    lowpass = KaiserLowpass(drop.motion.rate, settings.cutoff, settings.attenuation_db, settings.transition)
    return {**lowpass.describe(), "simulation filtered too": settings.filter_simulation}


def score_values(
    campaign: GearCampaign, drops: tuple[PreparedDrop, ...], values: Mapping[str, float], **options: Any
) -> PopulationCost:
    """Score one set of parameter values [SI] on prepared drops; absent names take the campaign's.

    The way to ask what the truth of a synthetic campaign scores.
    """
    space = search_space(campaign)
    default = parameters_on(campaign.surface.law).nominal
    full = {**default, **measured_values(campaign), **space.fixed, **values}
    row = np.array([[full[name] for name in PARAMETERS]])
    return GearObjective.build(campaign, space, drops, **options).score(row)
