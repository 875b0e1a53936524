"""The first-order rotor nearest to an identified motor, for simulators whose rotor is a lag per direction.

The lag is `sysid.motor.simpler` with T_up and T_down for T_rise and T_fall, and

    thrust = k_T Ω²,  drag torque = k_M thrust

Valid for steps of the command within forward rotation, where the constants come from; ignores the dead band
of a reversal, the winding's inductance, and that a step's time constant falls with the speed.
"""

import math
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize_scalar

from sysid.errors import ExportError
from sysid.motor.model import PARAMETERS, aerodynamic_torque, simulate, steady_state, thrust
from sysid.types import FloatArray

TIMES = ("time_constant_up", "time_constant_down")
# Steps of the command that the time constants are fitted to: around hover, small and large, up and back.
STEPS = ((0.4, 0.6), (0.6, 0.8), (0.4, 0.8))
# Length of a step's response [s], and its samples.
_LENGTH, _SAMPLES = 0.6, 601
_BOUNDS = (1e-4, 1.0)
# Commands at which a curve of thrust over command is compared with a flight controller's.
_LEVELS = 201
# Share of the largest speed by which the speed still rises above a level at which thrust is limited [1]: half
# of it is what load cells tell apart.
_LIMITED = 0.005


class FirstOrderRotor:
    """Constants of the first-order rotor nearest to a motor, each found when it is read.

    `parameters` by name [SI]; the command delay is left out. Constants are of forward rotation, because the
    symmetric rotors of simulators have no place for reverse; a value that is unknown (NaN) makes NaN of what
    rests on it. `time_constant_up` and `time_constant_down` [s] among the parameters are those that logs show
    by themselves; steady `levels` (k, 2), command [1] and loaded speed [rad/s], replace the no-load line.
    ExportError where full command does not turn the motor, or gives no thrust.

    Notes
    -----
    Time constants minimize the squared distance from the motor's speed over `STEPS`. With both directions of
    a curve ``c2 Ω² + c1 Ω``, the constant that is nearest over 0..Ω_max is ``c2 + (5/4) c1/Ω_max``.
    """

    def __init__(self, parameters: Mapping[str, float], levels: FloatArray | None = None) -> None:
        known = {name: value for name, value in parameters.items() if name in PARAMETERS}
        self.parameters = PARAMETERS.filled(known | {"command_delay": 0.0})
        self.seen = {name: parameters[name] for name in TIMES if name in parameters}
        self.levels = levels

    @cached_property
    def maximum_speed(self) -> float:
        """Loaded steady speed at full command and the reference voltage [rad/s]."""
        return self._top(1.0)

    @cached_property
    def thrust_constant(self) -> float:
        """Thrust over squared speed k_T [N·s²/rad²]."""
        constant, _ = self._nearest("thrust", "forward", self.maximum_speed)
        if constant <= 0:
            raise ExportError(
                f"motor: a thrust constant of {constant:g} N·s²/rad²; expected above 0, check the thrust "
                "curve"
            )
        return constant

    @cached_property
    def thrust_misfit(self) -> float:
        """Largest distance of k_T Ω² from the thrust curve, over the largest thrust [1]."""
        return self._nearest("thrust", "forward", self.maximum_speed)[1]

    @cached_property
    def torque_constant(self) -> float:
        """Drag torque over squared speed k_M k_T [N·m·s²/rad²]."""
        return self._nearest("torque", "forward", self.maximum_speed)[0]

    @property
    def moment_constant(self) -> float:
        """Drag torque over thrust k_M [m]."""
        return self.torque_constant / self.thrust_constant

    @property
    def maximum_thrust(self) -> float:
        """Thrust at full command [N]."""
        return float(thrust(self.maximum_speed, self.parameters))

    @property
    def time_constant_up(self) -> float:
        """Time constant while the speed grows [s]."""
        return self.seen.get("time_constant_up") or self._up[0]

    @property
    def time_constant_down(self) -> float:
        """Time constant while the speed falls [s]."""
        return self.seen.get("time_constant_down") or self._down[0]

    @property
    def misfit_up(self) -> float:
        """Rms distance of the lag from the motor's speed, over the step [1]."""
        return self._up[1]

    @property
    def misfit_down(self) -> float:
        """The same for steps down."""
        return self._down[1]

    @cached_property
    def reverse_maximum_speed(self) -> float:
        """Loaded steady speed at full reverse command [rad/s]."""
        return self._top(-1.0)

    @cached_property
    def reverse_thrust_constant(self) -> float:
        """Thrust over squared speed in reverse [N·s²/rad²]."""
        return self._nearest("thrust", "reverse", self.reverse_maximum_speed)[0]

    @property
    def limits(self) -> tuple[float, float]:
        """Commands at which thrust begins and from which on it does not rise any more [1].

        A controller starts above none, and a supply may end the rise below full command.
        """
        if self.levels is None:
            return 0.0, 1.0
        u, speed = self.levels.T
        first, last = (
            u[max(np.count_nonzero(speed <= 0.0) - 1, 0)],
            np.argmax(speed >= (1 - _LIMITED) * speed[-1]),
        )
        return float(first), 1.0 if last == len(u) - 1 else float(u[last])

    def expo(self, low: float = 0.0, high: float = 1.0, least: float = -1.0) -> tuple[float, float]:
        """Return e of ``t = (1 - e) x + e x²``, nearest to the thrust over commands from `low` to `high` [1].

        t and x are thrust and command over their ranges between both ends [1]; e stays between `least` and 1.
        The second number is the largest distance in t.
        """
        x = np.linspace(0.0, 1.0, _LEVELS)
        force = thrust(self.speed(low + (high - low) * x), self.parameters)
        t = (force - force[0]) / (force[-1] - force[0])
        bend = x * x - x
        e = float(np.clip(bend @ (t - x) / (bend @ bend), least, 1.0))
        return e, float(np.max(np.abs(t - x - e * bend)))

    def speed(self, command: FloatArray) -> FloatArray:
        """Return the loaded steady speed (...) [rad/s] of forward commands (...) [1]."""
        if self.levels is None:
            return steady_state(command, self.parameters)[1]
        u, speed = self.levels.T
        # The fit does the same: monotone between the levels, straight on beyond the last.
        slope = (speed[-1] - speed[-2]) / (u[-1] - u[-2])
        inside = PchipInterpolator(u, speed)(np.clip(command, u[0], u[-1]))
        return np.asarray(inside + np.maximum(command - u[-1], 0.0) * slope)

    def line_through(self, command: FloatArray, speed: FloatArray) -> dict[str, float]:
        """Return the no-load line under which two commands (2,) [1] end at loaded speeds (2,) [rad/s]."""
        p = self.parameters
        drag = aerodynamic_torque(speed, p) + p["viscous_damping"] * speed
        free = speed + p["winding_resistance"] * drag / (p["torque_constant"] * p["back_emf_constant"])
        slope = float((free[1] - free[0]) / (command[1] - command[0]))
        intercept = float(free[1] - slope * command[1])
        return {"no_load_slope_forward": slope, "no_load_intercept_forward": intercept}

    def _top(self, command: float) -> float:
        u = np.array(command)
        speed = abs(float(self.speed(u) if command > 0 else steady_state(u, self.parameters)[1]))
        if speed <= 0 or math.isinf(speed):
            way = "forward" if command > 0 else "reverse"
            raise ExportError(
                f"motor: turns at {speed:g} rad/s at full {way} command; expected speeds above 0, check the "
                "no-load speeds of the set"
            )
        return speed

    def _nearest(self, quantity: str, way: str, top: float) -> tuple[float, float]:
        """Return the constant k of k Ω² nearest to a curve over 0..top, and its largest distance over top."""
        quadratic, linear = (self.parameters[f"{quantity}_{name}_{way}"] for name in ("quadratic", "linear"))
        constant = quadratic + 1.25 * linear / top
        # The distance (c2 - k) Ω² + c1 Ω is largest at the top or where its slope is zero.
        places = [top]
        if constant != quadratic:
            places.append(min(top, max(0.0, linear / (2.0 * (constant - quadratic)))))
        largest = (quadratic * top + linear) * top
        return constant, max(abs((quadratic - constant) * w * w + linear * w) for w in places) / largest

    @cached_property
    def _up(self) -> tuple[float, float]:
        return self._lag(STEPS)

    @cached_property
    def _down(self) -> tuple[float, float]:
        return self._lag(tuple((b, a) for a, b in STEPS))

    def _lag(self, steps: tuple[tuple[float, float], ...]) -> tuple[float, float]:
        """Return the time constant nearest to the motor's responses to steps, and its misfit."""
        time = np.linspace(0.0, _LENGTH, _SAMPLES)
        if not math.isfinite(self.maximum_speed):
            return math.nan, math.nan
        shares = []
        for before, after in steps:
            p, both = self.parameters, np.array([before, after])
            if self.levels is not None:
                p = p | self.line_through(both, self.speed(both))
            current, speed = steady_state(before, p)
            run = simulate(p, [0.0], [after], time, initial=(float(current), float(speed)))
            end = float(steady_state(after, p)[1])
            shares.append((run.speed - end) / (float(speed) - end))
        measured = np.array(shares)

        def distance(logarithm: float) -> float:
            return float(np.sqrt(np.mean((measured - np.exp(-time / math.exp(logarithm))) ** 2)))

        low, high = (math.log(bound) for bound in _BOUNDS)
        least = minimize_scalar(distance, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
        return math.exp(float(least.x)), float(least.fun)
