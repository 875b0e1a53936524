"""A motor as Gazebo's multicopter motor model (SDF): one plugin per rotor with a set's constants.

The plugin (``gz::sim::systems::MulticopterMotorModel``) is a first-order lag of the speed with a time
constant up and one down, thrust ``motorConstant Ω|Ω|`` and drag torque ``momentConstant`` times thrust; it is
the same in both directions of rotation, and knows no dead band.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from sysid.errors import ExportError
from sysid.export.xml import add, comment, document, parse

_FILE, _CLASS = "gz-sim-multicopter-motor-model-system", "gz::sim::systems::MulticopterMotorModel"
# Number and sense of rotation, seen from above, of a quadrotor in X configuration.
ROTORS = ("ccw", "ccw", "cw", "cw")


@dataclass(frozen=True)
class MotorPlugin:
    """Numbers that the plugin reads, in the units of `_UNITS`."""

    timeConstantUp: float
    timeConstantDown: float
    maxRotVelocity: float
    motorConstant: float
    momentConstant: float


_UNITS = {
    "timeConstantUp": "s, while the speed grows",
    "timeConstantDown": "s, while it falls",
    "maxRotVelocity": "rad/s, loaded, at full forward command",
    "motorConstant": "N s^2/rad^2, forward",
    "momentConstant": "m, drag torque over thrust, forward",
}


def to_sdf(plugin: MotorPlugin, *, name: str = "motor", notes: tuple[str, ...] = ()) -> bytes:
    """Return an SDF document with the plugin of each rotor of a quadrotor; notes become comments."""
    root = Element("sdf", version="1.9")
    model = add(root, "model", name=name)
    for note in (
        "Written by sysid, SI units. Copy the plugins into the model of your vehicle, whose rotors are links "
        "rotor_0 to rotor_3 on joints rotor_0_joint to rotor_3_joint.",
        *notes,
    ):
        comment(model, note)
    for number, turns in enumerate(ROTORS):
        rotor = add(model, "plugin", filename=_FILE, name=_CLASS)
        add(rotor, "jointName", f"rotor_{number}_joint")
        add(rotor, "linkName", f"rotor_{number}")
        add(rotor, "turningDirection", turns)
        add(rotor, "motorType", "velocity")
        for key, unit in _UNITS.items():
            comment(rotor, unit)
            add(rotor, key, float(getattr(plugin, key)))
        add(rotor, "commandSubTopic", "command/motor_speed")
        add(rotor, "motorNumber", str(number))
        comment(
            rotor,
            "Not identified: on a bench the air stands still. 0 switches both off; the plugin's defaults "
            "are 1e-4 and 1e-6.",
        )
        add(rotor, "rotorDragCoefficient", "0")
        add(rotor, "rollingMomentCoefficient", "0")
        add(rotor, "rotorVelocitySlowdownSim", "10")
    return document(root)


def from_sdf(data: bytes) -> MotorPlugin:
    """Return the numbers of the first rotor's plugin; ExportError where one is missing."""
    root = parse(data, "SDF")
    plugin = next((p for p in root.iter("plugin") if p.get("name") == _CLASS), None)
    numbers: Mapping[str, str | None] = {} if plugin is None else {k: plugin.findtext(k) for k in _UNITS}
    if not numbers or None in numbers.values():
        raise ExportError("no complete multicopter motor model plugin; export the fit again")
    return MotorPlugin(**{key: float(str(value)) for key, value in numbers.items()})
