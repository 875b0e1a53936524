"""The first-order rotor nearest to an identified motor, for simulators whose rotor is a lag per direction.

The lag is `sysid.motor.simpler` with T_up and T_down for T_rise and T_fall, and

    thrust = k_T Ω²,  drag torque = k_M thrust

Valid for steps of the command within one direction of rotation, where the time constants come from; ignores
the dead band of a reversal, the winding's inductance, and that a step's time constant falls with the speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from sysid.errors import ExportError
from sysid.motor.model import PARAMETERS, simulate, steady_state

# Steps of the command that the time constants are fitted to: around hover, small and large, up and back.
STEPS = ((0.4, 0.6), (0.6, 0.8), (0.4, 0.8))
# Length of a step's response [s], and its samples.
_LENGTH, _SAMPLES = 0.6, 601
_BOUNDS = (1e-4, 1.0)


@dataclass(frozen=True)
class FirstOrderRotor:
    """Constants of a first-order rotor with a quadratic thrust curve.

    Time constants T_up and T_down [s], and the rms distance of the lag from the motor's speed over the steps,
    over the size of the step [1]; the loaded steady speed at full forward command [rad/s]; k_T [N·s²/rad²]
    and the largest distance of k_T Ω² from the identified curve over the largest thrust [1]; k_M [m]. Speed
    and thrust are forward; the symmetric rotors of simulators have no place for reverse rotation.
    """

    time_constant_up: float
    time_constant_down: float
    misfit_up: float
    misfit_down: float
    maximum_speed: float
    thrust_constant: float
    thrust_misfit: float
    moment_constant: float
    reverse_maximum_speed: float
    reverse_thrust_constant: float


def first_order_rotor(parameters: Mapping[str, float]) -> FirstOrderRotor:
    """Return the first-order rotor nearest to a motor with `parameters` [SI], the command delay left out.

    ExportError when full command does not turn the motor or gives no thrust.

    Notes
    -----
    Time constants minimize the squared distance from the motor's speed over `STEPS`. With both directions of
    a curve ``c2 Ω² + c1 Ω``, the constant that is nearest over 0..Ω_max is ``c2 + (5/4) c1/Ω_max``.
    """
    p = PARAMETERS.filled({k: v for k, v in parameters.items() if k in PARAMETERS} | {"command_delay": 0.0})
    top, bottom = (abs(float(steady_state(u, p)[1])) for u in (1.0, -1.0))
    if not (math.isfinite(top) and math.isfinite(bottom) and top > 0 and bottom > 0):
        raise ExportError(
            f"motor: turns at {top:g} rad/s at full forward and {bottom:g} rad/s at full reverse command; "
            "expected speeds above 0, check the no-load speeds of the set"
        )
    forward, misfit = _nearest(p["thrust_quadratic_forward"], p["thrust_linear_forward"], top)
    reverse, _ = _nearest(p["thrust_quadratic_reverse"], p["thrust_linear_reverse"], bottom)
    torque, _ = _nearest(p["torque_quadratic_forward"], p["torque_linear_forward"], top)
    if not forward > 0:
        raise ExportError(
            f"motor: a thrust constant of {forward:g} N·s²/rad²; expected above 0, check the thrust curve"
        )
    up, misfit_up = _lag(p, STEPS)
    down, misfit_down = _lag(p, tuple((b, a) for a, b in STEPS))
    return FirstOrderRotor(
        up, down, misfit_up, misfit_down, top, forward, misfit, torque / forward, bottom, reverse
    )


def _nearest(quadratic: float, linear: float, top: float) -> tuple[float, float]:
    """Return the constant k of k Ω² nearest to a curve over 0..top, and its largest distance over the top."""
    constant = quadratic + 1.25 * linear / top
    # The distance (c2 - k) Ω² + c1 Ω is largest at the top or where its slope is zero.
    places = [top]
    if constant != quadratic:
        places.append(min(top, max(0.0, linear / (2.0 * (constant - quadratic)))))
    largest = (quadratic * top + linear) * top
    return constant, max(abs((quadratic - constant) * w * w + linear * w) for w in places) / largest


def _lag(parameters: Mapping[str, float], steps: tuple[tuple[float, float], ...]) -> tuple[float, float]:
    """Return the time constant nearest to the motor's responses to steps of the command, and its misfit."""
    time = np.linspace(0.0, _LENGTH, _SAMPLES)
    shares = []
    for before, after in steps:
        current, speed = steady_state(before, parameters)
        run = simulate(parameters, [0.0], [after], time, initial=(float(current), float(speed)))
        end = float(steady_state(after, parameters)[1])
        shares.append((run.speed - end) / (float(speed) - end))
    measured = np.array(shares)

    def distance(logarithm: float) -> float:
        return float(np.sqrt(np.mean((measured - np.exp(-time / math.exp(logarithm))) ** 2)))

    low, high = (math.log(bound) for bound in _BOUNDS)
    least = minimize_scalar(distance, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    return math.exp(float(least.x)), float(least.fun)
