"""The array breeders of the default search against pymoo's own algorithms, which are slow and obvious."""

import numpy as np
import pytest
from pymoo.algorithms.soo.nonconvex.cmaes import CMAES
from pymoo.algorithms.soo.nonconvex.ga import GA

from sysid.fit.breeders.algorithms import PymooBreeder, Start, breeder
from sysid.fit.breeders.evolution_strategy import EvolutionStrategy


def cost_of(cube, digits=12):
    """A bowl whose bottom lies outside the cube in some directions; few digits make ties."""
    return np.sqrt(np.mean((cube - np.linspace(-0.1, 0.8, cube.shape[1])) ** 2, axis=1)).round(digits)


def assert_same_search(own, other, generations, digits):
    for generation in range(generations):
        points = own.ask()
        np.testing.assert_array_equal(points, other.ask(), f"generation {generation}", strict=True)
        if points is None:
            return generation
        cost = cost_of(points, digits)
        own.tell(cost)
        other.tell(cost)
        for mine, theirs in zip(own.population(), other.population(), strict=True):
            np.testing.assert_array_equal(mine, theirs)
    return generations


# An odd population has an incomplete last mating; three digits give hundreds of tied tournaments.
@pytest.mark.parametrize(("n_free", "population", "digits"), [(10, 100, 12), (3, 41, 3), (1, 8, 2)])
def test_the_ga_is_pymoos_bit_for_bit(n_free, population, digits):
    own = breeder("ga", n_free, population, 7)
    other = PymooBreeder(GA(pop_size=population, seed=7), n_free)
    assert assert_same_search(own, other, 25, digits) == 25


@pytest.mark.parametrize(("n_free", "population"), [(10, 64), (2, 12)])
def test_cmaes_is_pymoos_bit_for_bit(n_free, population):
    spread = np.full(n_free, 0.3)
    spread[0] = 0.01
    # Near two faces, so that the mapping into the box matters.
    start = Start(np.linspace(0.01, 0.97, n_free), spread)
    own = EvolutionStrategy(start.mean, start.spread, population, np.random.default_rng(5))
    random = np.random.default_rng(5)
    options = {"tolfun": 0.0, "tolx": 0.0, "randn": lambda *shape: random.standard_normal(shape)}
    largest = float(spread.max())
    other = PymooBreeder(
        CMAES(x0=start.mean, sigma=largest, pop_size=population, CMA_stds=spread / largest, **options), n_free
    )
    # pymoo scores the starting point, whose cost cma never sees.
    other.ask()
    other.tell(np.full(1, np.inf))
    assert assert_same_search(own, other, 40, 12) == 40
    assert np.min(own.population()[0]) < 0.05
