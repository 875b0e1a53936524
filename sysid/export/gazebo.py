"""A motor as Gazebo's multicopter motor model (SDF): one plugin per rotor with a set's constants.

The plugin (``gz::sim::systems::MulticopterMotorModel``) is a first-order lag of the speed with a time
constant up and one down, thrust ``motorConstant Ω|Ω|`` and drag torque ``momentConstant`` times thrust; it is
the same in both directions of rotation, and knows no dead band.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from sysid.export.xml import document


@dataclass(frozen=True)
class MotorPlugin:
    """Numbers that the plugin reads, in the units of `UNITS`."""

    timeConstantUp: float
    timeConstantDown: float
    maxRotVelocity: float
    motorConstant: float
    momentConstant: float


UNITS = {
    "timeConstantUp": "s, while the speed grows",
    "timeConstantDown": "s, while it falls",
    "maxRotVelocity": "rad/s, loaded, at full forward command",
    "motorConstant": "N s^2/rad^2, forward",
    "momentConstant": "m, drag torque over thrust, forward",
}


def to_sdf(plugin: MotorPlugin, *, name: str = "motor", notes: tuple[str, ...] = ()) -> bytes:
    """Return an SDF document with the plugin of each rotor of a quadrotor; notes become comments."""
    return document("gazebo.sdf.j2", plugin=asdict(plugin), units=UNITS, name=name, notes=list(notes))
