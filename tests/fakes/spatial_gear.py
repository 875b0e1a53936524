"""Drops in space: the exported model with four single legs in MuJoCo, released with a roll and a yaw.

Stands in for `sysid.gear.model.simulate` in `synthesize_gear`. The legs at an end stand as far apart as the
ends do and bend in the body's pitch plane only, as `sysid.export.mjcf` writes them.
"""

import math
from types import SimpleNamespace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from sysid.export.mjcf import to_mjcf
from sysid.gear.model import Status

# Least height of the lowest foot above the surface at the release [m].
_CLEAR = 2e-3


def lowest_foot(true, slope, start, turn):
    """Distance of the lowest of four feet from the surface, legs at rest, a body turned by `turn` [m]."""
    dx, dz = true["foot_dx"], true["foot_dz"]
    feet = turn.apply([[s * dx, t * dx, -dz] for s in (-1, 1) for t in (-1, 1)])
    feet += [start[0], 0.0, start[1]]
    return float((feet @ [math.sin(slope), 0.0, math.cos(slope)]).min())


def drop_in_space(true, slope, start, clock, turn, *, sticks=False):
    """Place (n, 3) [m] and rotations of a body released at rest, at a clock (n,) [s] from the release."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(true, slope=slope, per_leg=True, sticks=sticks).decode())
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    data.qpos[:3] = start[0], 0.0, start[1]
    data.qpos[3:7] = turn.as_quat()[[3, 0, 1, 2]]
    longest, body = model.opt.timestep, model.body("body").id
    place, quaternion = np.empty((len(clock), 3)), np.empty((len(clock), 4))
    for n in range(len(clock)):
        if n:
            span = clock[n] - clock[n - 1]
            steps = math.ceil(span / longest)
            model.opt.timestep = span / steps
            mujoco.mj_step(model, data, steps)
        mujoco.mj_kinematics(model, data)
        place[n], quaternion[n] = data.xpos[body], data.xquat[body]
    return place, Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


def released(roll, yaw):
    """What takes the place of `sysid.gear.model.simulate`: one attitude at the release [rad]."""

    def simulate(true, slope, start, clock, *, surface, tolerance):
        turn = Rotation.from_euler("ZX", [yaw, roll])
        assert lowest_foot(true, slope, start, turn) > 0.0
        place, turns = drop_in_space(true, slope, start, clock, turn, sticks=surface == "hf")
        matrix = turns.as_matrix()
        pitch = np.unwrap(np.arctan2(matrix[:, 0, 2], matrix[:, 2, 2]))
        state = np.column_stack([place[:, 0], place[:, 2], pitch])
        return SimpleNamespace(status=Status.OK, state=state, pose=(place[:, 1], turns))

    return simulate


def simulator(seed=0, roll=0.0, yaw=0.0, attitudes=None):
    """As `released`, with another attitude for every drop.

    `roll` and `yaw` are standard deviations [rad]; an attitude whose lowest foot would not hang clear is
    drawn again. The attitudes are appended to a list, drop by drop.
    """
    source = np.random.default_rng(seed)

    def simulate(true, slope, start, clock, **law):
        while True:
            drawn = roll * source.standard_normal(), yaw * source.standard_normal()
            if lowest_foot(true, slope, start, Rotation.from_euler("ZX", drawn[::-1])) > _CLEAR:
                break
        if attitudes is not None:
            attitudes.append(drawn)
        return released(*drawn)(true, slope, start, clock, **law)

    return simulate
