"""A drone to land: one gear set and one motor set, and what hovering needs of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from sysid.errors import ExportError
from sysid.gear import model as gear_model
from sysid.gear.surfaces import find_surface
from sysid.motor import model as motor_model
from sysid.parameter_sets import ParameterSets, RankedSet

Pairing = Literal["each", "best"]
PAIRINGS: tuple[Pairing, ...] = ("each", "best")
# Of equal motors that share a command at each end of the body.
MOTORS_PER_PAIR = 2


@dataclass(frozen=True, eq=False)
class Drone:
    """One set of the gear with one set of its motors, by parameter name [SI], under a surface's friction law.

    The motor's ``command_delay`` delays every command. The `name` is for tables and sentences.
    """

    gear: Mapping[str, float]
    motor: Mapping[str, float]
    surface: str
    name: str = ""

    @cached_property
    def row(self) -> np.ndarray:
        """Row (n_par,) that the gear's kernel reads."""
        return gear_model.pack(self.gear, self.surface)

    def value(self, name: str) -> float:
        """Return a number of the gear, by default the surface's [SI]."""
        return float(self.row[list(gear_model.PARAMETERS).index(name)])

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

    Every gear set goes with the motor's best set, or set i with set i ("each").

    Raises `ExportError` as `drone` does, or when there are too few motor sets.
    """
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
    name = f"{gear.sets.name} set {gear.rank}"
    return Drone(gear.known(gear_model.PARAMETERS), rotor, surface, name)
