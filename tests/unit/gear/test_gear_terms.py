"""Terms on trial: nothing changes without them, and the ladder names the one that drops were made with."""

import numpy as np
import pytest

from sysid.gear.model import Drops, pack, simulate_population
from sysid.gear.parameters import PARAMETERS

TERMS = PARAMETERS.group("term")
CLOCK = np.arange(0, 0.6, 1 / 250)


def drop(law, **values):
    drops = Drops(np.array([0.2]), np.array([[0.0, 0.25, 0.02, 0.0, -0.7, 0.0]]), [CLOCK])
    return simulate_population(pack(values, law)[None], drops, surface=law)


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
