"""A motor as Gazebo's multicopter motor model (SDF): one plugin per rotor with a set's constants.

The plugin (``gz::sim::systems::MulticopterMotorModel``) is a first-order lag of the speed with a time
constant up and one down, thrust ``motorConstant Ω|Ω|`` and drag torque ``momentConstant`` times thrust; it is
the same in both directions of rotation, and knows no dead band.
"""

from __future__ import annotations

from sysid.export.xml import document
from sysid.motor.nearest_lag import FirstOrderRotor


def to_sdf(rotor: FirstOrderRotor, *, name: str = "motor", notes: tuple[str, ...] = ()) -> bytes:
    """Return an SDF document with the plugin of each rotor of a quadrotor; notes become comments."""
    numbers = (
        ("timeConstantUp", rotor.time_constant_up, "s, while the speed grows"),
        ("timeConstantDown", rotor.time_constant_down, "s, while it falls"),
        ("maxRotVelocity", rotor.maximum_speed, "rad/s, loaded, at full forward command"),
        ("motorConstant", rotor.thrust_constant, "N s^2/rad^2, forward"),
        ("momentConstant", rotor.moment_constant, "m, drag torque over thrust, forward"),
    )
    return document("gazebo.sdf.j2", numbers=list(numbers), name=name, notes=list(notes))
