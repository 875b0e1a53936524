"""Options of a search, each declared once: what it is called, means and accepts, and its default.

Campaigns (``[fit]``), the command line and Python (`sysid.marks`), the record of a fit and what must be equal
for a fit to be continued take them from here; `sysid.fit.settings` says what follows from them. The program's
help needs this module, so it imports nothing heavy.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from annotated_types import Ge, Gt

from sysid.marks import Flag, seconds

Algorithm = Literal["ga", "matlab-ga", "cmaes", "de", "pso"]
Finisher = Literal["least-squares", "cmaes", "none"]
Reading = Literal["relative", "matlab"]
ALGORITHMS: tuple[Algorithm, ...] = get_args(Algorithm)
# Algorithm of a fit that names none, and the population of each algorithm where none is named. Chosen by
# tests/benchmarks/engine.py; the paper's own population is 200 for a motor and 400 to 800 for a gear.
DEFAULT_ALGORITHM: Algorithm = "ga"
POPULATION: dict[Algorithm, int] = {"ga": 100, "matlab-ga": 400, "cmaes": 64, "de": 100, "pso": 100}
_PANEL, _CAMPAIGN = "Search", "the campaign's"


@dataclass(frozen=True)
class CampaignSearch:
    """Options that a campaign may state in ``[fit]``; those with a flag, a command and Python as well."""

    # Individuals per generation of the first stage [1]; 0 stands for the algorithm's own number. The largest
    # takes 1 GB of memory, for the distances between all pairs.
    population: Annotated[
        int,
        Flag("Individuals per generation.", least=8, most=10_000, default="the algorithm's", panel=_PANEL),
    ] = 0
    # Independent runs [1]; the paper uses 5.
    runs: Annotated[
        int, Flag("Number of independent runs.", least=1, most=1000, default=_CAMPAIGN, panel=_PANEL)
    ] = 5
    # Seed of the fit; every run draws from another child of it.
    seed: Annotated[int, Flag("Seed of the random numbers.", least=0, default=_CAMPAIGN, panel=_PANEL)] = 1
    # Generation limit of every stage [1].
    max_generations: Annotated[
        int, Flag("End every run after this many generations.", least=1, default=_CAMPAIGN, panel=_PANEL)
    ] = 1000
    algorithm: Annotated[Algorithm, Flag("Search algorithm.", default=_CAMPAIGN, panel=_PANEL)] = (
        DEFAULT_ALGORITHM
    )
    # Least squares from the best of a few generations; where a little more is left than noise, CMA-ES along
    # the axes of the curvature follows, where much more, ten generations and least squares over whole windows
    # before it. The default was chosen by tests/benchmarks/engine.py.
    finish: Annotated[
        Finisher,
        Flag("Let this follow every run. 'none' is the paper's method.", default=_CAMPAIGN, panel=_PANEL),
    ] = "least-squares"
    # How "NRMSE change over 4 generations" is computed.
    stop_reading: Reading = "relative"
    # Generations over which the change is taken [1].
    stop_window: Annotated[int, Ge(1)] = 4
    # Change below which a stage has converged [1]; 0, for code alone, never converges.
    stop_tolerance: Annotated[float, Gt(0)] = 1e-4
    # Whether every stated value of the campaign is taken without error.
    exact: Annotated[
        bool,
        Flag(
            "Take every stated value as exact, as the paper does.", "--exact", default=_CAMPAIGN, panel=_PANEL
        ),
    ] = False


@dataclass(frozen=True)
class SearchOptions(CampaignSearch):
    """Options of a search; those beside the campaign's are for a command and Python, and count for a fit."""

    # Candidates that may be scored [1]; a generation that would exceed it is not begun (the first always is).
    max_evaluations: Annotated[
        int | None, Flag("End the fit after this many candidates.", least=1, panel=_PANEL)
    ] = None
    # Wall time of search and intervals [s].
    time_limit: Annotated[
        float | None,
        Flag(
            "End the fit and its intervals after this time, as in 20min, and keep its result.",
            read=seconds,
            panel="Computing",
        ),
    ] = None
