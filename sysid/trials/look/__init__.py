"""Content of a recording and what looks wrong with it, before anything is fitted.

    from sysid.trials.look import inspect_recording
    report = inspect_recording(load("drop.csv"))
    report.suspicions, report.drop, report.bench

Judges only what one recording shows; nothing is changed, and a suspicion is for a human to check.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter

from sysid.journal import Finding
from sysid.recording import Recording
from sysid.shown import Shown
from sysid.trials.capture import signed_axis
from sysid.trials.look.advice import length_advice
from sysid.trials.look.bench import BenchReport, inspect_bench
from sysid.trials.look.channels import ChannelReport, inspect_channel
from sysid.trials.look.drop import STANDARD_GRAVITY, DropReport, hanging_turn, inspect_drop

if TYPE_CHECKING:
    import pandas as pd

# A capture volume is no larger [m].
_FARTHEST = 100.0
_WRONG_GRAVITY = 0.03
_CROOKED = np.radians(5.0)
# A body is hung level by eye, and its axes are defined on a table.
_TILTED = np.radians(10.0)
# Units of length in a sentence, where it says them otherwise than an option.
_IN_WORDS = {"inch": "inches", "foot": "feet", "m": "metres, read as mm"}


@dataclass(frozen=True, repr=False)
class LogReport(Shown):
    """What is known about one log.

    Its duration is the time from the first to the last sample of any channel [s], NaN for a static map; its
    channels are in file order. A drop is there where a body falls, a bench for a running log of a thrust
    stand or load cell. Suspicions say what looks like a mistake, notes what the loader noticed and did.
    """

    path: str
    sha256: str
    format: str
    device: str
    kind: str
    duration: float
    channels: tuple[ChannelReport, ...]
    drop: DropReport | None
    bench: BenchReport | None
    suspicions: tuple[Finding, ...]
    notes: tuple[Finding, ...]

    def __repr__(self) -> str:
        lasts = "" if math.isnan(self.duration) else f", {self.duration:.4g} s"
        doubts = f"{len(self.suspicions) or 'no'} suspicion{'' if len(self.suspicions) == 1 else 's'}"
        head = f"<LogReport {Path(self.path).name} ({self.kind}, {self.format})"
        return f"{head}: {len(self.channels)} channels{lasts}, {doubts}>"

    def to_frame(self) -> pd.DataFrame:
        """Return what is known about each channel, one row each."""
        import pandas as pd

        return pd.DataFrame([asdict(channel) for channel in self.channels]).set_index("name")

    def remarks(self) -> tuple[Finding, ...]:
        """Return suspicions and notes."""
        return tuple(dict.fromkeys((*self.suspicions, *self.notes)))

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values for JSON; a number that is unknown is None."""
        stated: dict[str, Any] = json.loads(TypeAdapter(LogReport).dump_json(self))
        for name in ("suspicions", "notes"):
            stated[name] = [str(finding) for finding in getattr(self, name)]
        return stated


def log_quality(name: str, use: str, report: LogReport) -> dict[str, Any]:
    """Return how good the log of a trial is, as `sysid check` states it."""
    channels = report.channels
    return {
        "name": name,
        "use": use,
        "log": Path(report.path).name,
        "rate": max((channel.rate for channel in channels), default=math.nan),
        "jitter": max((channel.jitter for channel in channels), default=math.nan),
        "holes": max((channel.holes for channel in channels), default=0),
        "saturated": max((channel.saturated for channel in channels), default=0.0),
        "suspicions": [str(finding) for finding in report.suspicions],
    }


def inspect_recording(recording: Recording, gravity: float = STANDARD_GRAVITY) -> LogReport:
    """Return the content of a recording and what looks wrong with it, under a gravity [m/s²]."""
    clock = recording.kind != "static-map"  # its points follow one another in no time
    channels = tuple(inspect_channel(channel, clock) for channel in recording.channels.values())
    suspicions = [finding for finding in recording.provenance.notes if finding.severity == "warning"]
    drop, bench = None, None
    if recording.kind in ("thrust-stand", "load-cell"):
        bench, findings = inspect_bench(recording)
        suspicions += findings
    if recording.kind == "motion-capture":
        drop = inspect_drop(recording, gravity)
        suspicions += _capture_suspicions(recording, drop, gravity)
    suspicions += [
        Finding(
            "saturated",
            f"{c.name} sits at its limit ({c.highest:.4g} {c.unit}) for {100 * c.saturated:.2g} % of the "
            "samples: the sensor may be saturated",
        )
        for c in channels
        if c.saturated > 0
    ]
    suspicions += [
        Finding("blank-channel", f"{c.name} has no value at all") for c in channels if c.blank == 1.0
    ]
    clocks = [channel.time for channel in recording.channels.values() if channel.time.size]
    first, last = min((t[0] for t in clocks), default=0.0), max((t[-1] for t in clocks), default=0.0)
    provenance = recording.provenance
    return LogReport(
        provenance.path, provenance.sha256, provenance.format, provenance.device, recording.kind,
        float(last - first) if clock else math.nan,
        channels, drop, bench, tuple(suspicions), provenance.notes,
    )  # fmt: skip


def _capture_suspicions(recording: Recording, drop: DropReport | None, gravity: float) -> Iterator[Finding]:
    far = [
        (name, float(np.nanmax(np.abs(channel.values))))
        for name, channel in recording.channels.items()
        if name.endswith("/position") and channel.valid.any()
    ]
    name, distance = max(far, key=lambda place: place[1], default=("", 0.0))
    if distance > _FARTHEST and (drop is None or not drop.length_unit):  # one unit is suspected, not two
        yield Finding(
            "length-unit",
            f"{name} reaches {distance:.4g} m: lengths are probably mm; {length_advice(recording, 'mm')}",
        )
    if drop is None:
        return
    if drop.length_unit:
        words = _IN_WORDS.get(drop.length_unit, drop.length_unit)
        advice = length_advice(recording, drop.length_unit)
        yield Finding("length-unit", f"{drop.body} falls as if lengths were in {words}; {advice}")
        return
    # 3 % over a flight of 0.2 s is a few sample errors; shorter flights determine g worse.
    flight = drop.touchdown - (drop.release if drop.release is not None else drop.touchdown - 0.1)
    if abs(drop.gravity / gravity - 1.0) > max(_WRONG_GRAVITY, 0.01 / max(flight, 1e-3)):
        yield Finding(
            "wrong-gravity",
            f"{drop.body} falls with {drop.gravity:.3g} m/s² instead of {gravity:.4g}: check the rate, the "
            "length unit and that nothing brakes it",
        )
    if drop.up_error > _CROOKED:
        yield Finding(
            "tilted-capture",
            f"the fall is {np.degrees(drop.up_error):.0f} deg off the axis {drop.up}: the capture's ground "
            "plane is tilted",
        )
    orientation = recording.channels.get(f"{drop.body}/orientation")
    if orientation is not None and drop.release is not None:
        up, hanging = signed_axis(drop.up), hanging_turn(orientation, drop.release)
        tilt = 0.0 if hanging is None else float(np.arccos(np.clip(hanging.apply(up) @ up, -1.0, 1.0)))
        if tilt > _TILTED:
            yield Finding(
                "hangs-tilted",
                f"{drop.body} hangs {np.degrees(tilt):.0f} deg off level before its release: check the order "
                "of the quaternion's components, and that the body was level when the capture defined it",
            )
    if drop.up[0] == "-":
        sentence = f'{drop.body} falls toward +{drop.up[1]}: that axis points down; set up = "{drop.up}"'
        yield Finding("axis-down", sentence)
    elif drop.up[1] == "x":
        sentence = f'{drop.body} falls along x: axes may be swapped; set up = "{drop.up}"'
        yield Finding("axes-swapped", sentence)
