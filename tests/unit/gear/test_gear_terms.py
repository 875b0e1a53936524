"""Terms on trial: nothing changes without them, and the ladder names the one that drops were made with."""

import numpy as np
import pytest

from sysid.gear.model import Drops, pack, simulate, simulate_population
from sysid.gear.parameters import PARAMETERS

TERMS = PARAMETERS.group("term")
CLOCK = np.arange(0, 0.6, 1 / 250)


def drop(law, **values):
    drops = Drops(np.array([0.2]), np.array([[0.0, 0.25, 0.02, 0.0, -0.7, 0.0]]), [CLOCK])
    return simulate_population(pack(values, law)[None], drops, surface=law)


def test_front_feet_that_rub_unlike_keep_their_own_limit():
    start, true = np.array([-0.2, 0.35, 0.05, 1.0, -0.7, 0.0]), pack({"front_friction_excess": 0.2}, "hf")
    values = dict(zip(PARAMETERS, true.tolist(), strict=True))
    run = simulate(values, 0.35, start, np.arange(0, 0.6, 1e-3), surface="hf")
    loaded = run.normal_force > 1.0
    share = np.abs(run.friction_force) / np.where(loaded, run.normal_force, np.inf)
    kinetic, static = values["kinetic_friction"], values["static_friction_excess"]
    for foot, grip in enumerate((1.0, 1.2)):
        # Forces are read between steps: 1 %.
        assert np.isclose(share[:, foot], grip * kinetic, rtol=0.01).sum() >= 3
        assert share[:, foot].max() <= 1.01 * grip * (kinetic + static)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["lf", "hf"])
def test_terms_of_no_size_leave_every_bit(law):
    plain = drop(law)
    # The smallest number switches the terms on and moves nothing.
    extended = drop(law, leg_axial_hardening=5e-324)
    np.testing.assert_array_equal(extended.samples, plain.samples)
    for name in TERMS:
        moved = np.abs(drop(law, **{name: 0.1 * PARAMETERS[name].upper}).samples - plain.samples).max()
        assert moved > 1e-4, name
