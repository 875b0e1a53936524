"""Files of named signals (HDF5, MAT, TDMS, LVM): the signals of a file become a `Recording`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.load_cell import MEASURED
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import LogFormat
from sysid.loaders.signals import Signal, signal_channels
from sysid.loaders.source import Source
from sysid.recording import Recording

_TAKES = ("rate", "units", "datasets", "pulses_per_revolution", "time_back")


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


def signal_format(
    name: str,
    describes: str,
    recognize: Callable[[Source], int],
    parse: Callable[[Source, BenchOptions], AbstractContextManager[RawSignals]],
    extra: Mapping[str, tuple[str, ...]] | None = None,
) -> LogFormat:
    """Return a `LogFormat` of named signals.

    ``with parse(source, options) as RawSignals:`` keeps the file open while its signals are read; `extra`
    are options of this format alone, as `LogFormat.takes`.
    """

    def read(source: Source, **given: Any) -> Recording:
        options = BenchOptions(**given)
        with parse(source, options) as raw:
            channels, notes = signal_channels(
                source.path, raw.signals, options, measured=raw.measured, passed_over=raw.passed_over
            )
        if not channels:
            raise LogError(f"{source.path}: holds no signal with a value; the log is empty")
        return Recording(
            "load-cell" if any(channel in channels for channel in MEASURED) else "signals",
            channels,
            source.provenance(name, device=raw.device, options=options, notes=[*raw.notes, *notes]),
        )

    takes = {option: () for option in _TAKES} | dict(extra or {})
    read.__module__ = parse.__module__
    return LogFormat(name, describes, recognize, read, takes)
