"""What every load-cell log shares: names of its columns and datasets, and the channels made from them."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.recording import Channel, FloatArray

TIME = frozenset({"time", "t", "timestamp", "time stamp"})
TACHOMETER = frozenset({"tachometer", "tacho", "tach", "pulse", "pulses", "hall"})
COMMAND = frozenset({"command", "cmd", "throttle", "esc", "esc signal", "pwm"})


@dataclass(frozen=True)
class Quantity:
    """One channel of a load-cell log: the names it goes by and the unit it is converted to."""

    stems: frozenset[str]
    unit: str
    shown: str = ""


def _axis(kind: str, letters: str, axis: str) -> frozenset[str]:
    return frozenset({f"{letter}{axis}" for letter in letters} | {f"{kind} {axis}", f"{letters[0]} {axis}"})


# Thrust and torque are the z components: the axis of the motor on a six-axis cell under it.
QUANTITIES = {
    "speed": Quantity(frozenset({"speed", "motor speed", "rotor speed", "omega", "ω", "rpm"}), "rad/s"),
    "thrust": Quantity(_axis("force", "f", "z") | {"thrust"}, "N"),
    "torque": Quantity(_axis("torque", "mt", "z") | {"moment z", "torque"}, "N*m", "N·m"),
    "force_x": Quantity(_axis("force", "f", "x"), "N"),
    "force_y": Quantity(_axis("force", "f", "y"), "N"),
    "torque_x": Quantity(_axis("torque", "mt", "x") | {"moment x"}, "N*m", "N·m"),
    "torque_y": Quantity(_axis("torque", "mt", "y") | {"moment y"}, "N*m", "N·m"),
    "voltage": Quantity(frozenset({"voltage", "supply voltage", "battery voltage"}), "V"),
    "current": Quantity(frozenset({"current", "supply current", "motor current"}), "A"),
}
# At least one of these makes a log a load-cell log.
MEASURED = ("thrust", "torque")
# Names that only a force sensor has.
CELL_AXES = (QUANTITIES["thrust"].stems - {"thrust"}) | {"mz", "moment z"}
# A second log beside the cell's may hold nothing but these.
BESIDE = QUANTITIES["speed"].stems | QUANTITIES["voltage"].stems | QUANTITIES["current"].stems | TACHOMETER


def quantity_channel(name: str, time: FloatArray, values: FloatArray) -> Channel:
    """Return the channel of a quantity already in SI."""
    quantity = QUANTITIES[name]
    return Channel(name, quantity.shown or quantity.unit, time, values)
