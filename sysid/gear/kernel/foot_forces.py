"""Forces of the ground on the feet, read from states that a driver has left."""

from typing import Any

import numpy as np
from numba import njit

from sysid.gear.kernel.contact import normal_force
from sysid.gear.kernel.driver import fingerprint
from sysid.gear.kernel.dynamics import feet, pose
from sysid.gear.kernel.lane import begin
from sysid.gear.kernel.work_buffer import COEFFICIENTS, GROUND, LAW, ROWS
from sysid.gear.surfaces.surface import Surface, specialized

# Bound to a surface's own when a reader is made.
friction: Any = None


def force_reader(surface: Surface):
    """Make the function that reads the forces on the feet from states."""
    sources = fingerprint(surface)
    continuous = not surface.switching

    def foot_forces(parameters, reads, slope, states, forces):
        """Fill `forces` (n, 4) of states (n, 14), frame N: normal rear, front, friction rear, front [N].

        Friction only where the law is a function of the state.
        """
        if sources < 0:  # keeps the sources' hash in the key of the cached code
            return
        work = np.ones(ROWS)
        for n in range(len(states)):
            state = states[n]
            legs = np.array(
                [state[3], state[4], state[5], state[6], state[10], state[11], state[12], state[13]]
            )
            body = np.array([state[0], state[1], state[2], state[7], state[8], state[9]])
            begin(parameters, reads, slope, body, legs, work, 0, 1)
            y = work[:14]
            p = work[COEFFICIENTS:]
            joints = pose(y[2], y[4], y[6], p[8], p[9])
            rates = (y[7], y[8], y[9], y[10], y[11], y[12], y[13])
            p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, y[1], y[3], y[5], rates, p[10])
            forces[n, 0] = normal_force(p_c, dp_c, work[GROUND], work[GROUND + 1])
            forces[n, 1] = normal_force(p_d, dp_d, work[GROUND], work[GROUND + 1])
            if continuous:
                k = LAW
                law = (work[k], work[k + 1], work[k + 2], work[k + 3], work[k + 4], work[k + 5])
                found = friction(forces[n, 0], forces[n, 1], v_c, v_d, law)
                forces[n, 2] = found[0]
                forces[n, 3] = found[1]

    return njit(cache=True, nogil=True, error_model="numpy")(
        specialized(foot_forces, friction=surface.friction)
    )
