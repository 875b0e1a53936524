"""Files of a motor bench: load-cell logs at 10 kHz and the averaged points of a thrust stand."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from sysid.types import FloatArray

_GRAM_FORCE = 9.80665e-3
_RPM = 2 * np.pi / 60
# Series 1580/1585 header as the program writes it; the last name is empty because of the trailing comma.
_STAND_COLUMNS = (
    "Time (s),ESC signal (µs),Servo 1 (µs),Servo 2 (µs),Servo 3 (µs),AccX (g),AccY (g),AccZ (g),Torque (N·m),"
    "Thrust ({thrust}),Voltage (V),Current (A),Motor Electrical Speed (RPM),Motor Optical Speed (RPM),"
    "Electrical Power (W),Mechanical Power (W),Motor Efficiency (%),Propeller Mech. Efficiency ({thrust}/W),"
    "Overall Efficiency ({thrust}/W),Vibration (g),App message,"
)


class Sizes(NamedTuple):
    """A size of each channel: force [N], torque [N·m], speed [rad/s]."""

    force: float
    torque: float
    speed: float


# White noise of load cell and tachometer, one standard deviation per 10 kHz sample.
NOISE = Sizes(0.05, 1.5e-3, 1.0)
# The smallest step that each instrument reports.
RESOLUTION = Sizes(0.01, 1.25e-4, 0.05)


@dataclass(frozen=True, eq=False)
class LoadCellLog:
    """What a load cell, a tachometer and the command line delivered on one uniform clock, (n,) arrays.

    Time [s], pulse width [µs], signed speed [rad/s], Fz along the forward thrust [N] and Mz, the stator's
    reaction [N·m]; tare included.
    """

    time: FloatArray
    command: FloatArray
    speed: FloatArray
    force: FloatArray
    torque: FloatArray


def quantized(values: FloatArray, step: float) -> FloatArray:
    """Round values (n,) to whole steps of an instrument [unit of the values]."""
    return np.asarray(np.round(values / step) * step, dtype=np.float64)


def load_cell_csv(log: LoadCellLog) -> str:
    """Return a load-cell log as CSV: time, command, speed, Fz, Mz."""
    out = io.StringIO()
    out.write("Time (s),Command (µs),Speed (rad/s),Fz (N),Mz (N·m)\n")
    table = np.column_stack([log.time, log.command, log.speed, log.force, log.torque])
    # + 0.0 turns a negative zero into zero.
    np.savetxt(out, table + 0.0, fmt=["%.4f", "%.0f", "%.2f", "%.2f", "%.6f"], delimiter=",")
    return out.getvalue()


def load_cell_hdf5(log: LoadCellLog) -> Callable[[Path], None]:
    """Return a function that writes a load-cell log as `sysid.loaders.readers.load_cell_hdf5` reads it."""

    def write(path: Path) -> None:
        import h5py

        channels = {
            "Command": (log.command, "us"),
            "Speed": (log.speed, "rad/s"),
            "Fz": (log.force, "N"),
            "Mz": (log.torque, "N·m"),
        }
        with h5py.File(path, "w") as file:
            file.attrs["rate"] = round((len(log.time) - 1) / float(log.time[-1] - log.time[0]), 6)
            file.attrs["start"] = float(log.time[0])
            file.attrs["device"] = "six-axis load cell, synthesized"
            for name, (values, unit) in channels.items():
                data = file.create_dataset(
                    name, data=values.astype(np.float32), compression="gzip", compression_opts=9, shuffle=True
                )
                data.attrs["unit"] = unit

    return write


@dataclass(frozen=True, eq=False)
class StandPoints:
    """Averaged points (n,) of a thrust stand, in the order in which they were taken; blanks are NaN.

    Time [s], pulse width [µs], speed of the optical probe, which does not know the direction [rad/s], thrust
    [N] and torque [N·m] with tare, voltage [V] and current [A] of the supply.
    """

    time: FloatArray
    command: FloatArray
    speed: FloatArray
    thrust: FloatArray
    torque: FloatArray
    voltage: FloatArray
    current: FloatArray


def stand_csv(
    points: StandPoints, source: np.random.Generator, *, thrust_unit: Literal["N", "gf"] = "gf"
) -> str:
    """Return averaged points as RCbenchmark's program writes them for a Series 1580.

    A byte-order mark, a comma at the end of every line, no servos, the electrical speed probe off. `source`
    shakes the accelerometer columns, which nobody uses.
    """
    thrust = points.thrust / (_GRAM_FORCE if thrust_unit == "gf" else 1.0)
    power = points.voltage * points.current
    shaft = np.abs(points.torque) * points.speed
    columns: list[Sequence[float] | FloatArray | None] = [points.time, points.command, None, None, None]
    columns += [level + 0.005 * source.standard_normal(len(points.time)) for level in (-0.055, 0.025, -0.995)]
    columns += [points.torque, thrust, points.voltage, points.current]
    columns += [np.zeros(len(points.time)), np.round(points.speed / _RPM, 1), power, shaft]
    columns += [_ratio(100 * shaft, power), _ratio(np.abs(thrust), shaft), _ratio(np.abs(thrust), power)]
    columns += [0.058 + 0.004 * source.standard_normal(len(points.time)), None]
    lines = [_STAND_COLUMNS.format(thrust=thrust_unit)]
    for row in range(len(points.time)):
        values = [np.nan if column is None else float(column[row]) for column in columns]
        lines.append(",".join("" if np.isnan(value) else f"{value:.10g}" for value in values) + ",")
    return "\ufeff" + "\n".join(lines) + "\n"


def _ratio(above: FloatArray, below: FloatArray) -> FloatArray:
    """Divide, 0 where nothing turns, as the program does."""
    return np.where(np.abs(below) > 1e-3, above / np.where(np.abs(below) > 1e-3, below, 1.0), 0.0)
