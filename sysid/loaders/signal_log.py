"""Files of named signals (HDF5, MAT, TDMS, LVM) become a `Recording`.

A signal is found by the name that its file gives it, in any case, or by the option ``datasets``; its unit is
stated by the file or declared; its clock is, in this order, the declared rate, the times that come with it, a
signal named time beside it (whose unit must be stated or declared too), the rate that the file states. A unit
that is only the end of a name (``Fz_N``) is taken for known quantities, whose dimension shows a mistake, and
noted; of other signals it is not.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.clock import DECLARE_RATE, declared_rate, order_rows, rate_clock
from sysid.loaders.columns import Column, DeclaredUnits, factor_or_none, listing, listing_note, split_label
from sysid.loaders.load_cell import MEASURED, STEMS, UNITS, check_tachometer, shown_unit, speed_channel
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import family_format
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import Channel, FloatArray, Recording

# SI units of signals that are no known quantity. Temperatures (scales with an offset) and a bare "g" (gram or
# standard gravity) are kept as recorded.
_OTHER_UNITS = ("V", "A", "W", "N", "N*m", "Pa", "m/s^2", "m/s", "rad/s", "rad", "m", "s", "Hz", "1")
# Largest relative difference [1] of the lengths of two signals of one rate, and of a stated rate from the
# rate of the times: no clock drifts by as much.
_LENGTHS, _RATES = 0.02, 0.1


@dataclass(frozen=True)
class Signal:
    """One signal of a file.

    `name` has its group (``/cell/Fz``) and `label` has not; `unit` is None where the file states none;
    `read` returns the samples (n,). `rate` [Hz] and `start` [s] are as the file states them, `time` (n,) [s]
    is the signal's clock; `inherited`: the whole file has this rate. `numbered`: the label ends in the
    number of a matrix's column, ``FT[1]``, which is no unit.
    """

    name: str
    unit: str | None
    read: Callable[[], FloatArray]
    rate: object = None
    start: float = 0.0
    time: FloatArray | None = None
    label: str = ""
    inherited: bool = False
    numbered: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", self.label or self.name.rsplit("/", 1)[-1])

    @property
    def group(self) -> str:
        """Name of its group."""
        return self.name.removesuffix(self.label).rstrip("/")

    @cached_property
    def column(self) -> Column:
        """Name and unit of the signal, in the form in which a table states its columns."""
        stem, unit, guessed = split_label(self.label)
        if self.unit is not None or self.numbered:
            unit, guessed = self.unit, False
        return Column(0, self.label, stem, unit, guessed)

    @property
    def is_time(self) -> bool:
        """Whether it is a clock by its name; a ``T`` in degrees is a temperature."""
        if self.column.stem != "t" or self.column.unit is None:
            return self.column.stem in STEMS["time"]
        return factor_or_none(self.column.unit, "s") is not None


@dataclass
class RawSignals:
    """Content of a file of named signals.

    `measured`: only known quantities are read, thrust or torque among them; else signals of other names are
    kept too, in SI where their unit is known and as recorded (unit ``""``) where it is not. `passed_over`
    names what else is in the file.
    """

    signals: Sequence[Signal]
    device: str = ""
    measured: bool = True
    passed_over: Sequence[str] = ()
    notes: list[Finding] = field(default_factory=list)


def _named(path: str, signals: Mapping[str, Signal], datasets: object, what: str) -> dict[str, str]:
    """Return channel -> signal name as the user states them in `datasets`; `what` is in the file."""
    if not isinstance(datasets, Mapping):
        raise LogError(
            f'{path}: datasets = {datasets!r} is no table; expected for example {{thrust = "/ft/Fz"}}'
        )
    chosen = {}
    for channel, where in datasets.items():
        if channel not in STEMS:
            raise LogError(f'{path}: datasets names "{channel}"; it can name {", ".join(STEMS)}')
        given = str(where)
        full = next((name for name in (given, "/" + given.strip("/")) if name in signals), None)
        if full is None:
            same = [name for name, signal in signals.items() if signal.label == given]
            if len(same) != 1:
                raise LogError(f"{path}: no dataset /{given.strip('/')}; found {what}")
            full = same[0]
        chosen[str(channel)] = full
    return chosen


def _choose(path: str, signals: Mapping[str, Signal], raw: RawSignals, datasets: object) -> dict[str, str]:
    """Return channel -> signal name, ``time``, ``command`` and ``tachometer`` included.

    Exactly the `datasets` are chosen where the user names them. A named signal that is not there, two signals
    of one channel and a missing thrust are a LogError, which shows what is in the file.
    """
    passed = f"; passed over: {listing(raw.passed_over)}" if raw.passed_over else ""
    what = f"{listing(signals)}{passed}"
    chosen: dict[str, str] = {}
    if datasets is not None:
        chosen = _named(path, signals, datasets, what)
    else:
        for channel, stems in STEMS.items():
            matches = [
                name
                for name, signal in signals.items()
                if (signal.is_time if channel == "time" else signal.column.stem in stems)
            ]
            if len(matches) > 1 and channel != "time":
                raise LogError(
                    f"{path}: datasets {matches[0]} and {matches[1]} both look like {channel}; "
                    f'choose with datasets = {{{channel} = "{matches[0]}", ...}}'
                )
            if len(matches) == 1:
                chosen[channel] = matches[0]
    if raw.measured and not any(channel in chosen for channel in MEASURED):
        raise LogError(
            f'{path}: no dataset "Fz" or "Mz"; found {what}; '
            'name them with datasets = {thrust = "...", torque = "..."}'
        )
    return chosen


@dataclass
class _Clocks:
    """Signals gathered by the clock that they share, so that each clock is checked and kept once."""

    path: str
    signals: Mapping[str, Signal]
    rate: float | None
    time: str | None
    seconds: Callable[[str], float]

    def __post_init__(self) -> None:
        self.notes: list[Finding] = []
        self.shared: dict[float, tuple[str, int]] = {}
        self.numbers: dict[object, Numbers] = {}
        self.members: dict[object, list[str]] = {}

    def add(self, channel: str, name: str) -> None:
        signal = self.signals[name]
        values = signal.read()
        if not values.size:
            raise LogError(f"{self.path}: dataset {name} is empty; the log has no samples")
        values = np.where(np.isinf(values), np.nan, values)
        # Signals that are no known quantity may be short rows of settings, whose length is not compared.
        key, time = self._clock(name, signal, values.size, known=channel != name)
        group = self.numbers.setdefault(
            key, Numbers({0: time}, np.arange(1, time.size + 1), row_word="sample")
        )
        self.members.setdefault(key, []).append(channel)
        group.columns[len(self.members[key])] = values

    def _clock(self, name: str, signal: Signal, size: int, *, known: bool) -> tuple[object, FloatArray]:
        if self.rate is None and signal.time is not None:
            doubt = self._off_rate(name, signal, signal.time, "its column of times")
            # A program that paces itself writes a Delta_X without meaning; its times were measured.
            self.notes += [note("rate-contradicts-times", f"{doubt}; the times were taken")] if doubt else []
            return id(signal.time), signal.time
        in_group = [other for other in self.signals.values() if other.group == signal.group]
        beside = [other.name for other in in_group if other.is_time and other is not signal]
        clock = beside[0] if len(beside) == 1 else self.time
        if self.rate is None and clock is not None:
            time = self.signals[clock].read() * self.seconds(clock)
            if time.size != size:
                raise LogError(
                    f"{self.path}: dataset {name} has {size} samples but its clock {clock} has "
                    f"{time.size}; they must be of one length"
                )
            if doubt := self._off_rate(name, signal, time, f"its clock {clock}"):
                raise LogError(
                    f"{self.path}: {doubt}; declare the true one with rate = ..., or correct the file"
                )
            return clock, time
        hertz = declared_rate(self.path, signal.rate if self.rate is None else self.rate)
        if hertz is None:
            raise LogError(
                f"{self.path}: dataset {name} has no clock: no dataset time beside it and no attribute rate; "
                "declare the sample rate [Hz] with rate = ..."
            ).asking(rate=None)
        if known and (signal.inherited or self.rate is not None):
            first, length = self.shared.setdefault(hertz, (name, size))
            if abs(size - length) > max(1.0, _LENGTHS * length):
                raise LogError(
                    f"{self.path}: {first} has {length} samples and {name} has {size}, but both take "
                    f"one rate of {hertz:g} Hz, so one would last "
                    f"{max(size, length) / min(size, length):.3g} times as long as the other; give each "
                    "dataset a rate or a time, or choose datasets of one rate with datasets = {...}"
                )
        return (hertz, signal.start, size), rate_clock(self.path, hertz, size) + signal.start

    @staticmethod
    def _off_rate(name: str, signal: Signal, time: FloatArray, what: str) -> str:
        """Return how the rate and the times of a file contradict each other; empty where they agree."""
        steps = np.diff(time[np.isfinite(time)])
        rate = signal.rate
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not steps.size:
            return ""
        step = float(np.median(steps))
        if step <= 0 or abs(step * rate - 1.0) <= _RATES:
            return ""
        return f"{name} states {rate:g} Hz but {what} steps by {step:.6g} s"


def _channels(path: str, raw: RawSignals, options: BenchOptions) -> tuple[dict[str, Channel], list[Finding]]:
    """Return the channels of a file's signals and notes.

    A signal without a clock or a unit, and two that contradict each other, are a LogError or a UnitError.
    """
    per_revolution, named = options.pulses_per_revolution, options.datasets is not None
    rate = declared_rate(path, options.rate)
    by_name = {signal.name: signal for signal in raw.signals}
    chosen = _choose(path, by_name, raw, options.datasets)
    check_tachometer(path, chosen, per_revolution)
    declared = DeclaredUnits(path, options.units)
    clocks = _Clocks(
        path, by_name, rate, chosen.get("time"),
        lambda name: declared.factor(by_name[name].column, "time", "s"),
    )  # fmt: skip
    left = [] if named else [name for name in by_name if name not in chosen.values()]
    others = [] if raw.measured else [name for name in left if not by_name[name].is_time]
    for channel, name in [*chosen.items(), *zip(others, others, strict=True)]:
        if channel != "time":
            clocks.add(channel, name)
    notes = clocks.notes
    if raw.measured:
        notes += listing_note("datasets-not-read", "datasets not read", left)
    channels: dict[str, Channel] = {}
    unknown: list[str] = []
    for key, names in clocks.members.items():
        time, ordered = order_rows(path, clocks.numbers[key], 0, 1.0, options=options, coarse=DECLARE_RATE)
        notes += [finding for finding in ordered if finding not in notes]
        for index, channel in enumerate(names, start=1):
            values = clocks.numbers[key].columns[index]
            column = by_name[channel if channel in others else chosen[channel]].column
            if channel in others:
                # Only for a known quantity can the dimension show that the end of a name is no unit.
                if column.guessed:
                    column = replace(column, unit=None, guessed=False)
                unit, factor = plain_unit(declared.unit_of(column, column.label))
                unknown += [] if unit else [by_name[channel].label]
                label = " ".join(by_name[channel].label.split()) or channel
                shown = label if label not in channels else channel
                channels[shown] = Channel(shown, unit, time, values * factor)
            elif channel == "command":
                channels[channel] = Channel(channel, declared.command(column), time, values)
            elif channel == "tachometer":
                channels |= speed_channel(path, column.label, time, values, per_revolution, notes)
            else:
                default = "rpm" if column.stem == "rpm" else None
                scale = declared.factor(column, channel, UNITS[channel], default)
                channels[channel] = Channel(channel, shown_unit(UNITS[channel]), time, values * scale)
    notes += unknown_units_note(unknown)
    notes += listing_note("passed-over", "passed over, as no rows of numbers", raw.passed_over)
    declared.check_used([signal.column for signal in raw.signals])
    return channels, [*notes, *declared.notes]


def unknown_units_note(names: Sequence[str]) -> list[Finding]:
    """Return a note that names the signals whose unit is not known."""
    return listing_note("unknown-units", "signals without a known unit, kept as recorded", names)


def plain_unit(stated: str | None) -> tuple[str, float]:
    """Return (SI unit, factor) of a signal that is no known quantity; ``("", 1)`` if unknown."""
    stated = (stated or "").strip()
    # A decibel is logarithmic: no factor turns it into anything.
    if stated in ("", "g", "G") or stated.startswith("dB") or re.search("deg|°|º", stated):
        return "", 1.0
    for expected in _OTHER_UNITS:
        # The units library counts a radian as a pure number, as per cent, strain and counts are.
        if expected == "rad" and "rad" not in stated:
            continue
        if (factor := factor_or_none(stated, expected)) is not None:
            return shown_unit(expected), factor
    return "", 1.0


def written_unit(unit: str | None) -> str | None:
    """Return a unit as sysid reads it: LabVIEW and its users write whole words, ``Newtons``, ``Volts``."""
    text = (unit or "").strip()
    return (text.lower() if text.isalpha() and len(text) > 3 else text) or None


def unique_names(names: Sequence[str]) -> list[str]:
    """Return names in which a repeated one carries its number."""
    seen: dict[str, int] = {}
    out = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        out.append(name if seen[name] == 1 else f"{name} #{seen[name]}")
    return out


# Options of every format of named signals.
SIGNAL_OPTIONS = dict.fromkeys(("rate", "units", "datasets", "pulses_per_revolution", "time_back"), ())


_Parse = Callable[[Source, BenchOptions], AbstractContextManager[RawSignals]]


def _recording(source: Source, name: str, parse: _Parse, options: BenchOptions) -> Recording:
    with parse(source, options) as raw:  # the file stays open while its signals are read
        channels, notes = _channels(source.path, raw, replace(options, segment=None))
    if not channels:
        raise LogError(f"{source.path}: has no signal with a value; the log is empty")
    kind = "load-cell" if any(channel in channels for channel in MEASURED) else "signals"
    provenance = source.provenance(name, device=raw.device, options=options, notes=[*raw.notes, *notes])
    return Recording(kind, channels, provenance)


signal_format = partial(family_format, BenchOptions, _recording)
