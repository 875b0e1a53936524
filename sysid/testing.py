"""Checks of a kind of model, for the tests of its author."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sysid.api import Campaign, campaign_path
from sysid.errors import FitError, SysidError
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.problem import Problem
from sysid.fit.search import Hooks, run_many
from sysid.fit.settings import SearchSettings
from sysid.own import try_out
from sysid.types import FloatArray
from sysid.units import factor_to_si
from sysid.workflows.kinds import naming_campaign, open_campaign

# Points between the bounds at which a model is compared with itself.
_POINTS = 6
# A search of two stages, and the generation in the second one after which it is stopped.
_SEARCH, _STOP = SearchSettings(8, 1, 1, 3, "ga", "cmaes"), 5


def check_kind(campaign: str | Path | Campaign) -> None:
    """Check the kind of model that a campaign names on the campaign's trials, for a test of yours.

    * Units are known.
    * Costs between the bounds are finite, and at least one simulation runs to its end.
    * Every free parameter moves a residual.
    * Equal rows give equal bits, whatever their neighbours, their order and the number of threads.
    * A simulation that cannot succeed is counted as a failure: every parameter is NaN. One that NaN keeps
      busy ends by the `patience` of its model.
    * A search that is stopped and resumed finds the same bits as one that is not.

    Raises
    ------
    SysidError
        One sentence on the first of them that does not hold; also an AssertionError.

    Examples
    --------
    >>> import sysid.testing
    >>> sysid.testing.check_kind("data_samples/motor")
    """
    path = campaign_path(campaign)
    kind, content, _ = open_campaign(path)
    try:
        with naming_campaign(path):
            one, two = (kind.open(content, path, threads).fitted for threads in (1, 2))
            for unit in (*(row.unit for row in one.space.table.values()), *one.units):
                factor_to_si(unit)
            try_out(one)
            _check_numbers(one, two)
            _check_resumed(one)
    except SysidError as error:
        raise error.also(AssertionError) from None


def _check_numbers(one: Problem, two: Problem) -> None:
    """Compare the numbers of equal candidates; check that a failing simulation is counted."""
    cube = np.random.default_rng(1).random((_POINTS, len(one.space.free)))
    bits = _bits(one, cube)
    kind = one.campaign.kind
    if not np.isfinite(one.evaluate(cube).cost).all():
        raise FitError(f"{kind}: a cost is not finite between the bounds")
    for what, other in (
        ("when it is computed again", _bits(one, cube)),
        ("in another order", _bits(one, cube[::-1])[::-1]),
        ("without its neighbours", [_bits(one, point[None])[0] for point in cube]),
        ("with two threads", _bits(two, cube)),
    ):
        if other != bits:
            raise FitError(
                f"{kind}: the same candidate has other numbers {what}; its simulation must depend on "
                "nothing but its values, the time and the trial"
            )
    scores = one.score(np.full((1, len(one.space.table)), np.nan))
    if not (scores.cause > 0).all() or not np.isfinite(scores.by_channel).all():
        raise FitError(
            f"{kind}: values that are NaN do not make a simulation fail; let its exceptions and NaN out, so "
            "that failures are counted"
        )


def _bits(problem: Problem, cube: FloatArray) -> list[bytes]:
    """Return cost and residuals of every candidate."""
    cost, residuals = problem.evaluate(cube).cost, problem.residuals(cube)[0]
    return [np.append(row, one).tobytes() for one, row in zip(cost, residuals, strict=True)]


def _check_resumed(problem: Problem) -> None:
    """Compare a search that was stopped in its second stage and resumed with one that was not."""
    whole = run_many(problem, _SEARCH)
    with TemporaryDirectory() as folder:
        seen: list[int] = []
        stop = Hooks(lambda run, generation: seen.append(run), should_stop=lambda: len(seen) >= _STOP)
        for resume, hooks in ((False, stop), (True, Hooks())):
            held = Checkpoint(Path(folder) / "fit", {}, resume=resume)
            found = run_many(problem, _SEARCH, checkpoint=held, hooks=hooks)
            held.close()
    stages = [
        [(stage.cube.tobytes(), stage.cost.tobytes()) for stage in runs[0].stages] for runs in (whole, found)
    ]
    if stages[0] != stages[1]:
        raise FitError(
            f"{problem.campaign.kind}: a search that was stopped and resumed found other numbers; its "
            "simulation must not depend on what was simulated before"
        )
