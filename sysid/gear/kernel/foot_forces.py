"""Forces of the ground on the feet, read from states that a driver has left."""

from typing import Any

import numpy as np
from numba import njit

from sysid.gear.kernel import work_buffer as at
from sysid.gear.kernel.contact import normal_force
from sysid.gear.kernel.driver import fingerprint
from sysid.gear.kernel.lane import begin, feet_at_start
from sysid.gear.kernel.stage import law_at
from sysid.gear.surfaces.surface import Surface, specialized

# Bound to a surface's function when a reader is made.
friction: Any = None


def force_reader(surface: Surface):
    """Make the function that reads the forces on the feet from states."""
    sources = fingerprint(surface)
    continuous = not surface.switching

    def foot_forces(parameters, slope, states, forces):
        """Fill `forces` (n, 4) of states (n, 14), frame N: normal rear, front, friction rear, front [N].

        Friction only where the law is a function of the state.
        """
        if sources < 0:  # keeps the sources' hash in the key of the cached code
            return
        work = np.ones(at.ROWS)
        for n in range(len(states)):
            coordinates, rates = states[n, :7], states[n, 7:]
            legs = np.concatenate((coordinates[3:], rates[3:]))
            body = np.concatenate((coordinates[:3], rates[:3]))
            begin(parameters, slope, body, legs, work, 0, 1)
            p_c, dp_c, v_c, p_d, dp_d, v_d = feet_at_start(work, 0, 1)
            n_c = normal_force(p_c, dp_c, work[at.GROUND_SPRING], work[at.GROUND_DAMPER])
            n_d = normal_force(p_d, dp_d, work[at.GROUND_SPRING], work[at.GROUND_DAMPER])
            forces[n, 0] = n_c
            forces[n, 1] = n_d
            if continuous:
                forces[n, 2], forces[n, 3] = friction(n_c, n_d, v_c, v_d, law_at(work, at.LAW, 1))

    return njit(cache=True, nogil=True, error_model="numpy")(
        specialized(foot_forces, friction=surface.friction)
    )
