"""Motion captures: the bodies and markers of a file become a `Recording`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.columns import listing_note
from sysid.loaders.motion_capture import body_channels, lost_note, unit_quaternions
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import family_format
from sysid.loaders.rigid_pose import fit_bodies
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import Channel, Recording
from sysid.types import FloatArray


@dataclass
class Body:
    """One rigid body over `time` (n,) [s].

    `position` (n, 3) [m]; `orientation` (n, 4), quaternion, w first, body axes to capture axes, NaN where
    lost. With `rows`, the quaternion is as recorded in these rows of the file: its length and sign are still
    to be checked. `extra` has (unit, values) of other channels of the body: ``residual``, ``velocity``.
    """

    name: str
    time: FloatArray
    position: FloatArray
    orientation: FloatArray
    rows: Numbers | None = None
    extra: dict[str, tuple[str, FloatArray]] = field(default_factory=dict)


@dataclass
class RawCapture:
    """What a motion capture holds.

    `markers` are (time [s], position (n, 3) [m]) by name; `others` are signals beside the capture. `chosen`:
    `bodies` are already those of the option ``rigid_body``, so none is fitted for it. `states_length`: the
    file states its length unit, so the option ``length_unit`` changes nothing. `marks_lost`: the system
    writes frames in which it lost a body, so a note counts them.
    """

    device: str
    notes: list[Finding]
    bodies: list[Body] = field(default_factory=list)
    markers: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    others: dict[str, Channel] = field(default_factory=dict)
    chosen: bool = True
    states_length: bool = False
    marks_lost: bool = False
    kind: str = "motion-capture"


def _recording(
    source: Source, name: str, parse: Callable[[Source, CaptureOptions], RawCapture], options: CaptureOptions
) -> Recording:
    """Return the recording of a capture: unit quaternions of continuous sign, poses of marker sets fitted.

    A quaternion without unit length, a body that cannot be fitted and a capture that never saw anything are
    a LogError.
    """
    raw = parse(source, options)
    path, notes = source.path, list(raw.notes)
    channels: dict[str, Channel] = {}
    for body in raw.bodies:
        orientation = body.orientation
        if body.rows is not None:
            orientation, turned = unit_quaternions(path, body.name, body.rows, orientation)
            notes += turned
        channels |= body_channels(body.name, body.time, body.position, orientation)
        for what, (unit, values) in body.extra.items():
            channels[f"{body.name}/{what}"] = Channel(f"{body.name}/{what}", unit, body.time, values)
        if raw.marks_lost:
            notes += lost_note(body.name, orientation)
    blank = [key for key, (_, place) in raw.markers.items() if not np.isfinite(place).all(axis=1).any()]
    markers = {
        f"{marker}/position": Channel(f"{marker}/position", "m", time, place)
        for marker, (time, place) in raw.markers.items()
    }
    if options.bodies is not None or (options.rigid_body is not None and not raw.chosen):
        rigid_body = None if raw.chosen else options.rigid_body
        fitted, poses = fit_bodies(path, markers, options.bodies, rigid_body)
        channels |= fitted
        notes += poses
    for marker in blank:
        del markers[f"{marker}/position"]
    notes += listing_note("markers-never-seen", "markers never seen, left out", blank)
    channels |= {key: marker for key, marker in markers.items() if key not in channels}
    channels |= raw.others
    if not channels:
        raise LogError(f"{path}: no body, marker or signal is ever seen; the capture is empty")
    stated = replace(options, length_unit=None) if raw.states_length else options
    provenance = source.provenance(name, device=raw.device, options=stated, notes=notes)
    return Recording(raw.kind, channels, provenance)


capture_format = partial(family_format, CaptureOptions, _recording)
