"""Thrust of a pair of motors over time: what a command schedule does, ready for the landing gear.

The thrust does not depend on how the drone moves (axial and radial airspeed are ignored), so the two states
of a motor are integrated once per parameter set and schedule, by `sysid.motor.model.simulate`, which locates
every event. Every drop or landing of that set shares the result.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import FitError
from sysid.integrate.piecewise import PiecewiseCubic, refined
from sysid.motor import model
from sysid.types import FloatArray

# Longest piece to begin with [s]; error in the middle of a piece as a share of the largest thrust.
_LONGEST = 5e-3
_ERROR = 1e-6


def thrust_history(
    parameters: Mapping[str, float],
    command_time: ArrayLike,
    command: ArrayLike,
    duration: float,
    *,
    motors: int = 2,
    initial: tuple[float, float] | Literal["steady"] = "steady",
    ideal_reversal: bool = False,
) -> PiecewiseCubic:
    """Return the thrust of equal motors under a command schedule [N], from 0 to `duration` [s].

    The arguments are those of `sysid.motor.model.simulate`: ``[-1, 0]`` and ``[0.5, -1]`` is a reversal at
    time 0 from steady flight at half command; "steady" takes the equilibrium under the command just before
    time 0. FitError when the motor cannot be simulated or the duration is not positive.

    Notes
    -----
    Pieces end at every command and are halved until they follow the motor's own dense output within 1e-6 of
    the largest thrust; a jump of the motor torque (end of the dead band) is fenced in by pieces of 20 µs.
    """
    if not duration > 0:
        raise FitError(f"thrust history of {duration:g} s; give a duration above 0")
    instants, levels = model.schedule(command_time, command)
    p = model.PARAMETERS.filled(parameters)
    inertia, delay = p["rotor_inertia"], p["command_delay"]
    start = initial
    if isinstance(initial, str):
        level = levels[max(0, int(np.searchsorted(instants + delay, 0.0, side="left")) - 1)]
        before = model.simulate({**parameters, "command_delay": 0.0}, [0.0], [level], [0.0], initial="steady")
        start = (float(before.current[0]), float(before.speed[0]))

    def sample(time: FloatArray) -> tuple[FloatArray, FloatArray]:
        run = model.simulate(parameters, instants, levels, time, initial=start, ideal_reversal=ideal_reversal)
        rise = (run.stator_torque - model.aerodynamic_torque(run.speed, parameters)) / inertia
        return motors * run.thrust, motors * model.thrust_slope(run.speed, parameters) * rise

    knots = np.linspace(0.0, duration, max(2, int(np.ceil(duration / _LONGEST)) + 1))
    commands = instants + delay
    commands = commands[(commands > 0.0) & (commands < duration)]
    # Two instants that nearly coincide would leave a piece of no length.
    knots = knots[[not len(commands) or np.abs(commands - t).min() > 1e-5 for t in knots]]
    knots = np.unique(np.concatenate([[0.0], knots, commands, [duration]]))
    # No motor turns faster than its no-load speed.
    peak = motors * float(np.abs(model.thrust(model.no_load_speed(levels, parameters), parameters)).max())
    return refined(sample, knots, _ERROR * max(1e-3, peak))
