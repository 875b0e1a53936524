"""CMA-ES on whole generations against pymoo's own, which is slow and obvious."""

import subprocess
import sys

import numpy as np
import pytest
from pymoo.algorithms.soo.nonconvex.cmaes import CMAES

from sysid.fit.breeders.algorithms import PymooBreeder, Start
from sysid.fit.breeders.evolution_strategy import EvolutionStrategy


def cost_of(cube):
    """A bowl whose bottom lies outside the cube in some directions."""
    return np.sqrt(np.mean((cube - np.linspace(-0.1, 0.8, cube.shape[1])) ** 2, axis=1))


@pytest.mark.parametrize(("n_free", "population"), [(10, 64), (2, 12)])
def test_cmaes_is_pymoos_bit_for_bit(n_free, population):
    spread = np.full(n_free, 0.3)
    spread[0] = 0.01
    # Near two faces, so that the mapping into the box matters.
    start = Start(np.linspace(0.01, 0.97, n_free), spread)
    own = EvolutionStrategy(start, population, np.random.default_rng(5))
    random = np.random.default_rng(5)
    options = {"tolfun": 0.0, "tolx": 0.0, "randn": lambda *shape: random.standard_normal(shape)}
    largest = float(spread.max())
    other = PymooBreeder(
        CMAES(x0=start.mean, sigma=largest, pop_size=population, CMA_stds=spread / largest, **options), n_free
    )
    # pymoo scores the starting point, whose cost cma never sees.
    other.ask()
    other.tell(np.full(1, np.inf))
    for _ in range(40):
        points = own.ask()
        np.testing.assert_array_equal(points, other.ask(), strict=True)
        for one in (own, other):
            one.tell(cost_of(points))
        for ours, theirs in zip(own.population(), other.population(), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    assert np.min(own.population()[0]) < 0.05


@pytest.mark.parametrize("shortcuts", ["from . import s", ""])
def test_cma_brings_no_matplotlib_and_may_lose_its_shortcuts(tmp_path, shortcuts):
    package = tmp_path / "cma"
    package.mkdir()
    (package / "__init__.py").write_text(shortcuts)
    (package / "s.py").write_text("import matplotlib\nwhole = True")
    (package / "transformations.py").write_text("BoxConstraintsLinQuadTransformation = None")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "import sysid.fit.breeders.evolution_strategy, cma\n"
        "assert cma.__file__.startswith(sys.path[0])\n"
        "assert 'matplotlib' not in sys.modules and not hasattr(cma, 's')\n"
        "import cma.s\n"
        "assert cma.s.whole"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
