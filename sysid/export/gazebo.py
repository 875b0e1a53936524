"""A motor as Gazebo's multicopter motor model (SDF): one plugin per rotor with a set's constants.

The plugin (``gz::sim::systems::MulticopterMotorModel``) is a first-order lag of the speed with a time
constant up and one down, thrust ``motorConstant Ω|Ω|`` and drag torque ``momentConstant`` times thrust; it is
the same in both directions of rotation, and knows no dead band.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass

from sysid.errors import ExportError

_FILE, _CLASS = "gz-sim-multicopter-motor-model-system", "gz::sim::systems::MulticopterMotorModel"
# Number and sense of rotation, seen from above, of a quadrotor in X configuration.
ROTORS = ("ccw", "ccw", "cw", "cw")


@dataclass(frozen=True)
class MotorPlugin:
    """Numbers that the plugin reads.

    Parameters
    ----------
    timeConstantUp, timeConstantDown : float
        [s].
    maxRotVelocity : float
        [rad/s].
    motorConstant : float
        [N·s²/rad²].
    momentConstant : float
        [m].
    """

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
    """Return an SDF document with the plugin of each rotor of a quadrotor.

    Parameters
    ----------
    plugin : MotorPlugin
    name : str
        Of the model.
    notes : tuple of str
        Sentences for the reader, written as comments.
    """
    root = ElementTree.Element("sdf", version="1.9")
    model = ElementTree.SubElement(root, "model", name=name)
    for note in (
        "Written by sysid, SI units. Copy the plugins into the model of your vehicle, whose rotors are links "
        "rotor_0 to rotor_3 on joints rotor_0_joint to rotor_3_joint.",
        *notes,
    ):
        _say(model, note)
    for number, turns in enumerate(ROTORS):
        rotor = ElementTree.SubElement(model, "plugin", filename=_FILE, name=_CLASS)
        _put(rotor, "jointName", f"rotor_{number}_joint")
        _put(rotor, "linkName", f"rotor_{number}")
        _put(rotor, "turningDirection", turns)
        _put(rotor, "motorType", "velocity")
        for key, unit in _UNITS.items():
            _say(rotor, unit)
            _put(rotor, key, repr(float(getattr(plugin, key))))
        _put(rotor, "commandSubTopic", "command/motor_speed")
        _put(rotor, "motorNumber", str(number))
        _say(
            rotor,
            "Not identified: on a bench the air stands still. 0 switches both off; the plugin's own defaults "
            "are 1e-4 and 1e-6.",
        )
        _put(rotor, "rotorDragCoefficient", "0")
        _put(rotor, "rollingMomentCoefficient", "0")
        _put(rotor, "rotorVelocitySlowdownSim", "10")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def from_sdf(document: bytes) -> MotorPlugin:
    """Return the numbers of the first rotor's plugin.

    Raises
    ------
    ExportError
        When there is no such plugin or a number is missing.
    """
    try:
        root = ElementTree.fromstring(document)
    except ElementTree.ParseError as error:
        raise ExportError(f"not SDF ({error}); give a file that sysid export wrote") from error
    plugin = next((p for p in root.iter("plugin") if p.get("name") == _CLASS), None)
    found: Mapping[str, str | None] = {} if plugin is None else {k: plugin.findtext(k) for k in _UNITS}
    if not found or None in found.values():
        raise ExportError("no complete multicopter motor model plugin; export the fit again")
    return MotorPlugin(**{key: float(str(value)) for key, value in found.items()})


def _put(parent: ElementTree.Element, tag: str, text: str) -> None:
    ElementTree.SubElement(parent, tag).text = text


def _say(parent: ElementTree.Element, text: str) -> None:
    parent.append(ElementTree.Comment(f" {text.replace('--', '-')} "))
