"""What a design study must find where physics leaves no doubt."""

import numpy as np
import pytest

from fakes.published import table_1, table_2
from sysid.landing.controllers import find_controller
from sysid.landing.design_study import design_study, find_changes
from sysid.landing.drone import drones
from sysid.landing.settings import StudySettings


def landable(surface, vary, speeds, slopes=None, controller="reverse"):
    """Width of slopes landed on [deg], mean over the speeds, by value of the one change."""
    settings = StudySettings(tuple(np.arange(0.0, 61.0, 3.0)) if slopes is None else slopes, speeds)
    fleet = drones(table_2(surface), table_1())
    changes = find_changes(vary)
    found = design_study("x", fleet, changes, find_controller(controller), settings)
    order = found.along(0)
    values = dict(zip(found.points[order, 0].tolist(), found.landable[order].mean(axis=1), strict=True))
    return [values[v] for v in changes[0].axis]


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_wider_feet_land_on_steeper_slopes(surface):
    narrow, as_is, wide = landable(surface, "dx_f=0.7:1.4:2", (0.6, 1.2))
    # Narrow feet tip at atan(0.7 dx_f/dz_f) = 26 deg already when rigid, wide ones at 44 deg.
    assert narrow < as_is - 3.0
    assert wide > as_is + 3.0


def test_a_slower_reversal_lands_on_flatter_slopes():
    at_once, as_is, late = landable("hf", "reversal_delay=-45ms:250ms:2", (0.6, 1.2))
    # Landings bounce and are chaotic near their limits: a degree is chance.
    assert late < as_is - 1.0
    assert late < at_once - 1.0


def test_more_damping_along_the_legs_lands_on_steeper_slopes():
    little, as_is, much = landable("hf", "b_h=0.5:2:2", (0.6,))
    assert little < as_is < much


def test_weightless_thrust_buys_nothing():
    # Without reverse thrust the curve of reverse thrust does not matter: the same bits.
    assert len(set(landable("hf", "thrust_quadratic_reverse=0.5:2:2", (0.6,), controller="off"))) == 1
