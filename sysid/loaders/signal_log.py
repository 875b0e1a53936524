"""Files of named signals (HDF5, MAT, TDMS, LVM): the signals of a file become a `Recording`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.load_cell import MEASURED
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import family_format
from sysid.loaders.signals import Signal, signal_channels
from sysid.loaders.source import Source
from sysid.recording import Recording

# Options of every format of named signals.
SIGNAL_OPTIONS = dict.fromkeys(("rate", "units", "datasets", "pulses_per_revolution", "time_back"), ())


@dataclass
class RawSignals:
    """What a file of named signals holds.

    `measured`: only known quantities are read, thrust or torque among them; else signals of other names are
    kept too, in SI where their unit is known and as recorded (unit ``""``) where it is not. `passed_over`
    names what the file holds besides signals.
    """

    signals: Sequence[Signal]
    device: str = ""
    measured: bool = True
    passed_over: Sequence[str] = ()
    notes: list[Finding] = field(default_factory=list)


_Parse = Callable[[Source, BenchOptions], AbstractContextManager[RawSignals]]


def _recording(source: Source, name: str, parse: _Parse, options: BenchOptions) -> Recording:
    with parse(source, options) as raw:  # the file stays open while its signals are read
        channels, notes = signal_channels(
            source.path, raw.signals, options, measured=raw.measured, passed_over=raw.passed_over
        )
    if not channels:
        raise LogError(f"{source.path}: holds no signal with a value; the log is empty")
    kind = "load-cell" if any(channel in channels for channel in MEASURED) else "signals"
    provenance = source.provenance(name, device=raw.device, options=options, notes=[*raw.notes, *notes])
    return Recording(kind, channels, provenance)


signal_format = partial(family_format, BenchOptions, _recording)
