"""Calibration of an ATI force/torque transducer (``.cal``), and its transform to the motor's axis.

FT = UserAxis · (V − V_bias): six rows Fx Fy Fz Tx Ty Tz of six numbers, in the force and torque units that
the file states. ``UserAxis`` is used and not ``Axis``, as the file itself asks: it holds the scale and the
maker's basic transform already.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.columns import naming
from sysid.loaders.options import is_positive
from sysid.types import FloatArray
from sysid.units import factor_to_si, parse_quantity

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
_LENGTHS = ("dx", "dy", "dz")
_ANGLES = ("rx", "ry", "rz")
_LARGEST = 1 << 20


@dataclass(frozen=True, eq=False)
class Calibration:
    """A transducer's calibration.

    `matrix` (6, 6) turns gauge voltages into Fx Fy Fz [N] and Tx Ty Tz [N·m]; `limits` (6,) are the largest
    calibrated loads, NaN where not stated.
    """

    device: str
    matrix: FloatArray
    limits: FloatArray

    def beyond(self, load: FloatArray) -> list[str]:
        """Return the axes on which loads (n, 6) leave the calibrated range."""
        over = np.asarray(np.abs(load) > self.limits)
        return [axis for i, axis in enumerate(AXES) if over[:, i].any()]


def _numbers(path: str, axis: str, text: str) -> list[float]:
    try:
        values = [float(cell) for cell in text.split()]
    except ValueError:
        values = []
    if len(values) != 6 or not np.all(np.isfinite(values)):
        raise LogError(f"{path}: UserAxis {axis} does not hold six numbers; use the file as ATI sent it")
    return values


def read_calibration(path: str | Path) -> Calibration:
    """Read a ``.cal`` file; LogError or UnitError where it is missing, of another kind or unit."""
    where = str(path)
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise LogError(f"{where}: the calibration cannot be read ({error}); check calibration") from error
    # A calibration declares no entities; one that does could unfold into gigabytes.
    if len(data) > _LARGEST or b"<!" in data.replace(b"<!--", b""):
        raise LogError(
            f"{where}: not a calibration as ATI writes it; use the file that came with the transducer"
        )
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise LogError(
            f"{where}: the calibration is no XML ({error}); use the file as ATI sent it"
        ) from error
    node = root if root.tag == "Calibration" else root.find(".//Calibration")
    rows = {axis.get("Name", ""): axis for axis in (node.findall("UserAxis") if node is not None else [])}
    missing = [axis for axis in AXES if axis not in rows]
    if node is None or missing:
        raise LogError(
            f"{where}: no UserAxis {', '.join(missing) or 'rows'} in it; use the file as ATI sent it"
        )
    factors = []
    for key, expected in (("ForceUnits", "N"), ("TorqueUnits", "N*m")):
        unit = node.get(key, "")
        if not unit:
            raise UnitError(f"{where}: states no {key}; use the file as ATI sent it")
        with naming(f"{where}: {key}"):
            factors.append(factor_to_si(unit, expected))
    scale = np.repeat(factors, 3)
    matrix = np.array([_numbers(where, axis, rows[axis].get("values", "")) for axis in AXES]) * scale[:, None]
    limits = []
    for axis in AXES:
        try:
            limits.append(float(rows[axis].get("max", "nan")))
        except ValueError:
            limits.append(np.nan)
    parts = [root.get("BodyStyle", ""), root.get("Serial", ""), node.get("PartNumber", "")]
    device = " ".join(["ATI", *(part for part in parts if part)])
    return Calibration(device, matrix, np.array(limits) * scale)


def motor_transform(path: str, transform: Mapping[str, Any] | None) -> NDArray[np.float64]:
    """Return the (6, 6) matrix that turns a load at the transducer into one at the motor's axes.

    `transform` has ``dx dy dz``, from the transducer's origin to the motor's in the transducer's axes (``"10
    mm"``), and ``rx ry rz``, then turns of the axes about x, the new y, the new z (``"90 deg"``); 0 where
    not named. F' = Rᵀ F and T' = Rᵀ (T − d × F), with the columns of R the new axes. A key or a quantity
    that is not understood is a LogError or a UnitError.
    """
    if transform is not None and not isinstance(transform, Mapping):
        raise LogError(
            f'{path}: transform = {transform!r} is no table; expected for example {{dz = "20 mm"}}'
        )
    given = dict(transform or {})
    unknown = sorted(set(given) - {*_LENGTHS, *_ANGLES})
    if unknown:
        raise LogError(f'{path}: transform names "{unknown[0]}"; it can name dx, dy, dz, rx, ry, rz')
    with naming(f"{path}: transform"):
        d = np.array([parse_quantity(str(given.get(key, "0 m")), "m") for key in _LENGTHS])
        angles = [parse_quantity(str(given.get(key, "0 rad")), "rad") for key in _ANGLES]
    back = Rotation.from_euler("XYZ", angles).as_matrix().T
    cross = np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, 3:], out[3:, :3] = back, back, -back @ cross
    return out


def without_tare(
    path: str, values: FloatArray, time: FloatArray, tare: Any
) -> tuple[FloatArray, list[Finding]]:
    """Return values less the mean of the first `tare` seconds of each column, and a note; None takes nothing.

    A `tare` that is no positive time or holds no sample is a LogError.
    """
    if tare is None:
        return values, []
    if not is_positive(tare):
        raise LogError(
            f"{path}: tare = {tare!r}; expected seconds at the start of the log without load, or with their "
            'unit: tare = "1 s"'
        )
    first = time < time[0] + float(tare)
    seen = np.isfinite(values[first])
    if not seen.any(axis=0).all():
        raise LogError(f"{path}: the first {float(tare):g} s hold no sample to take the tare from")
    offset = np.asarray(np.nanmean(values[first], axis=0))
    sentence = f"tare: the mean of the first {tare:g} s was subtracted"
    return values - offset, [note("tare-subtracted", sentence)]
