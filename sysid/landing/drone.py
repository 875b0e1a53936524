"""A drone to land: one gear set and one motor set, hovering, and the thrust of its motor pairs.

The thrust does not depend on the motion, and before the trigger every landing hovers; so one history per
list of steps, on a clock that starts at the trigger, serves every slope and speed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import Literal

import numpy as np

from sysid.errors import ExportError
from sysid.gear import model as gear_model
from sysid.gear.propulsion import Propulsion
from sysid.gear.surfaces import find_surface
from sysid.integrate.piecewise import PiecewiseCubic
from sysid.landing.controllers import Step
from sysid.landing.settings import Scenario
from sysid.motor import model as motor_model
from sysid.motor.pair_thrust import thrust_history
from sysid.parameter_sets import DRAWS, ParameterSets, RankedSet

Pairing = Literal["each", "best"]
# Number of equal motors that share a command at each end of the body.
MOTORS_PER_PAIR = 2
# Time for which the thrust is computed after the last command [s], constant from then on: ten
# electromechanical time constants of 0.08 s, and a reversal ends after 0.25 s.
SETTLING = 1.0

Commands = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class Drone:
    """One set of the gear with one set of its motors, by parameter name [SI], under a surface's friction law.

    The motor's ``command_delay`` delays every command. The `name` is for tables and sentences.
    """

    gear: Mapping[str, float]
    motor: Mapping[str, float]
    surface: str
    name: str = ""
    sets: str = ""  # name of the sets that its gear is one of
    drawn: bool = False  # whether it is a draw of what the data leave open

    @cached_property
    def row(self) -> np.ndarray:
        """Row (n_par,) that the gear's kernel reads."""
        return gear_model.pack(self.gear, self.surface)

    def value(self, name: str) -> float:
        """Return a number of the gear, by default the surface's [SI]."""
        return float(self.row[list(gear_model.PARAMETERS).index(name)])

    def start(self, touchdown: Scenario) -> list[float]:
        """Return x_B, z_B, q_B and rates (6,) at touchdown, frame N [m, rad, s]; x_B is 0."""
        turn = touchdown.slope - touchdown.pitch
        depth = self.value("foot_dx") * abs(math.sin(turn)) + self.value("foot_dz") * math.cos(turn)
        height = depth / math.cos(touchdown.slope)
        rates = [touchdown.horizontal_speed, -touchdown.speed, touchdown.pitch_rate]
        return [0.0, height, touchdown.pitch, *rates]

    @property
    def weight(self) -> float:
        """Weight of the body and both pairs of legs [N]."""
        legs = self.value("leg_mass") * (1.0 + self.value("front_leg_mass_ratio"))
        return (self.value("body_mass") + legs) * self.value("gravity")

    @cached_property
    def hover_command(self) -> float:
        """Command u at which four equal motors carry the weight [1]; refused when full command does not.

        ``T(Ω) = W/4`` gives the loaded speed, ``Ω_0 = Ω + R (τ_aero(Ω) + k_d Ω)/(k_m k_v)`` the no-load
        speed that it needs, and the line ``Ω_0(u) = a u + b`` the command.
        """
        m = motor_model.PARAMETERS.nominal | dict(self.motor)
        quadratic, linear = m["thrust_quadratic_forward"], m["thrust_linear_forward"]
        share = self.weight / (2 * MOTORS_PER_PAIR)
        speed = 2 * share / (linear + math.sqrt(linear**2 + 4 * quadratic * share))
        torque = (m["torque_quadratic_forward"] * speed + m["torque_linear_forward"]) * speed
        torque += m["viscous_damping"] * speed
        no_load = speed + m["winding_resistance"] * torque / (m["torque_constant"] * m["back_emf_constant"])
        command = (no_load - m["no_load_intercept_forward"]) / m["no_load_slope_forward"]
        if not 0.0 < command <= 1.0:
            raise ExportError(
                f"{self.name or 'drone'}: hovering at {self.weight:.2f} N needs a command of {command:.2f}, "
                "expected 0 to 1; check the motor's thrust curve, its no-load speed and the body's mass"
            )
        return command


def drones(gear: ParameterSets, motor: ParameterSets, pairing: Pairing = "best") -> tuple[Drone, ...]:
    """Pair the sets of a gear with sets of a motor, one drone per gear set, best first.

    Every gear set goes with the motor's best set, or set i with set i ("each", and draws of a motor always).

    Raises `ExportError` as `drone` does, or when there are too few motor sets.
    """
    pairing = "each" if DRAWS in motor.provenance else pairing
    if pairing == "each" and len(motor) < len(gear):
        raise ExportError(
            f"{motor.name}: {len(motor)} motor sets for {len(gear)} gear sets; pair every gear set with the "
            "motor's best set (--pair best)"
        )
    rotors = [rank if pairing == "each" else 1 for rank in range(1, len(gear) + 1)]
    return tuple(drone(one, motor.set_values(rank)) for one, rank in zip(gear, rotors, strict=True))


def drone(gear: RankedSet, motor: RankedSet | None = None) -> Drone:
    """Return the drone of a gear's set and a motor's; without a motor it can only be dropped.

    The motor's ``command_delay`` belongs to the log's instruments and is left out. Raises `ExportError` when
    a kind is wrong or a number is unknown.
    """
    for values, kind in ((gear, "gear"), (motor, "motor")):
        if values is not None and values.sets.kind != kind:
            raise ExportError(
                f"{values.sets.name}: has {values.sets.kind} sets, expected {kind} sets; give the gear's "
                "sets first and the motor's with --motor"
            )
    rotor = {} if motor is None else motor.known(motor_model.PARAMETERS)
    rotor.pop("command_delay", None)
    surface = find_surface(str(gear.sets.settings.get("surface", "lf"))).name
    drawn = DRAWS in gear.sets.provenance
    name = f"{gear.sets.name} {'draw' if drawn else 'set'} {gear.rank}"
    return Drone(gear.known(gear_model.PARAMETERS), rotor, surface, name, gear.sets.name, drawn)


@dataclass(frozen=True)
class MotorState:
    """Command u [1], current [A] and speed [rad/s] of the (rear, front) motors when the trigger comes."""

    command: tuple[float, float]
    current: tuple[float, float]
    speed: tuple[float, float]


class Motors:
    """Thrust histories of one drone that hovers until the trigger, or whose motors then have a `state`."""

    def __init__(self, drone: Drone, ideal_reversal: bool = False, state: MotorState | None = None) -> None:
        self._state = state
        self._drone = drone
        self._ideal = ideal_reversal
        self._histories: dict[tuple[int, Commands], PiecewiseCubic] = {}

    def history(self, commands: Commands, pair: int = 0) -> PiecewiseCubic:
        """Return the thrust of a pair (0 rear, 1 front) [N] on the trigger's clock.

        `commands` are instants since the trigger [s] and the command u from each on. The pairs differ only
        where the motors have a `MotorState`.
        """
        # A command that repeats the one before changes nothing.
        changes = tuple(next(equal) for _, equal in groupby(commands, key=itemgetter(1)))
        state = self._state
        key = (0 if state is None else pair, changes)
        if key not in self._histories:
            times = [-1.0, *(time for time, _ in changes)]
            before = self._drone.hover_command if state is None else state.command[pair]
            levels = [before, *(level for _, level in changes)]
            self._histories[key] = thrust_history(
                self._drone.motor,
                times,
                levels,
                changes[-1][0] + SETTLING,
                motors=MOTORS_PER_PAIR,
                initial="steady" if state is None else (state.current[pair], state.speed[pair]),
                ideal_reversal=self._ideal,
            )
        return self._histories[key]

    def propulsion(self, steps: Sequence[Step], begins: float | Literal["first contact"] = 0.0) -> Propulsion:
        """Return the thrust of both pairs; the trigger comes at `begins` since the first sample [s]."""
        return Propulsion(
            self.history(tuple((step.after, step.rear) for step in steps)),
            self.history(tuple((step.after, step.front) for step in steps), pair=1),
            begins=begins,
            settled=steps[-1].after,
        )
