"""Two recordings of one event with a clock each: the offset between the clocks, and one recording of both.

The offset is where the cross-correlation of a channel of each, resampled to a common rate and
differentiated, is largest; a parabola through the peak refines it below the sample period. Valid for clocks
that run at one speed (crystals do to some 50 ppm: 3 ms per minute) and for events that both channels show
once; the confidence shows whether another offset would fit nearly as well.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from sysid.errors import LogError
from sysid.journal import note
from sysid.recording import Channel, FloatArray, Recording

# Largest rate at which channels are compared [Hz].
_LARGEST_RATE = 2000.0
# Least correlation and least confidence of an offset that is used without a look at the figures [1].
_WEAK, _UNSURE = 0.5, 0.2
# Correlation from which a smaller confidence suffices, and that confidence [1]: for alternating steps the
# correlation of the next best offset, half a period away, is only 0.1 to 0.15 lower.
_CLOSE, _UNSURE_CLOSE = 0.95, 0.1
# Fewest samples to align by.
_FEWEST = 20
# Width of the window over which changes are taken [s].
_SMOOTHING = 0.04
# Least overlap of two recordings, as a share of the shorter one [1].
_OVERLAP = 0.3


@dataclass(frozen=True)
class ClockOffset:
    """What aligns two clocks.

    `offset` [s] is added to the second recording's times; `correlation` is of the channels `reference` and
    `other` there (0 to 1); `confidence` is 1 - (second peak / first peak), 0 to 1.
    """

    offset: float
    correlation: float
    confidence: float
    reference: str
    other: str

    @property
    def sure(self) -> bool:
        """Whether the offset can be used without a look at the figures."""
        enough = _UNSURE if self.correlation < _CLOSE else _UNSURE_CLOSE
        return self.correlation >= _WEAK and self.confidence >= enough

    def sentence(self) -> str:
        """Return the offset and how clear it is, in words."""
        next_best = self.correlation * (1.0 - self.confidence)
        return (
            f"offset {self.offset:+.5g} s is {'clear' if self.sure else 'not clear'}: the changes of "
            f"{self.reference} and {self.other} correlate by {self.correlation:.2f} there and by "
            f"{next_best:.2f} at the next best offset"
        )


def _even(channel: Channel, other: Channel, rate: float) -> tuple[float, FloatArray]:
    """Return the start [s] and the changes of a channel on a uniform clock, of unit size.

    A speed counts by its signed square where the other channel is a load, which follows that: rising, Ω² lags
    Ω, falling it leads, so compared as they are, they would be milliseconds off.
    """
    values = channel.values if channel.values.ndim == 1 else np.linalg.norm(channel.values, axis=1)
    if channel.unit == "rad/s" and other.unit in ("N", "N·m"):
        values = values * np.abs(values)
    seen = np.isfinite(values)
    time = np.arange(channel.time[seen][0], channel.time[seen][-1], 1.0 / rate)
    even = np.interp(time, channel.time[seen], values[seen])
    # Changes determine the offset, slow parts do not. They are smoothed over the time that a rotor takes to
    # answer, because the noise of a load cell is larger than the change of its signal between two samples.
    window = np.hanning(max(7, 2 * round(_SMOOTHING * rate / 2.0) + 1))
    change = np.convolve(np.gradient(even), window / window.sum(), mode="same")
    return float(time[0]), np.asarray(change)


def find_offset(path: str, reference: Channel, other: Channel, *, sign: bool = True) -> ClockOffset:
    """Return the offset that brings the clock of a channel onto the reference.

    `path` is the second file, for messages. A speed is squared against a thrust or a torque; without `sign`
    the two may be of opposite sign. A channel that is too short or never changes is a LogError.
    """
    for channel in (reference, other):
        if channel.valid.sum() < _FEWEST:
            raise LogError(f"{path}: {channel.name} has {channel.valid.sum()} samples, too few to align by")
    rate = min(_LARGEST_RATE, max(reference.rate, other.rate))
    start, first = _even(reference, other, rate)
    other_start, second = _even(other, reference, rate)
    if not first.any() or not second.any() or min(first.size, second.size) < _FEWEST:
        raise LogError(f"{path}: {reference.name} or {other.name} never changes; align by another channel")
    products = signal.correlate(first, second, mode="full", method="fft")
    ones = (np.ones(first.size), np.ones(second.size))
    shared = np.round(signal.correlate(ones[0], ones[1], mode="full", method="fft"))
    # The score divides by the energy of the whole shorter recording, so that an offset at which all its
    # events overlap beats one at which a single event does, and by the energy of the overlap of the longer
    # one.
    longer = first.size >= second.size
    power = signal.correlate(first**2, ones[1], mode="full", method="fft") if longer else np.sum(first**2)
    other_power = (
        np.sum(second**2) if longer else signal.correlate(ones[0], second**2, mode="full", method="fft")
    )
    # A lag at which the recordings hardly overlap correlates by chance.
    allowed = shared >= _OVERLAP * min(first.size, second.size)
    # A floor under both energies keeps noise in a stretch without events from being divided by zero.
    floors = 1e-6 * np.max(power), 1e-6 * np.max(other_power)
    scale = np.sqrt(np.maximum(power, floors[0]) * np.maximum(other_power, floors[1]))
    score = np.where(allowed, (products if sign else np.abs(products)) / scale, -np.inf)
    best = int(np.argmax(score))
    lag = float(best)
    if 0 < best < score.size - 1 and np.isfinite(score[best - 1 : best + 2]).all():
        before, peak, after = score[best - 1 : best + 2]
        curve = before - 2.0 * peak + after
        lag += float(0.5 * (before - after) / curve) if curve < 0 else 0.0
    correlation = float(np.clip(score[best], 0.0, 1.0))
    offset = start - other_start + (lag - (second.size - 1)) / rate
    # The next peak, beyond the width of the first.
    low = high = best
    while low > 0 and score[low - 1] < score[low]:
        low -= 1
    while high < score.size - 1 and score[high + 1] < score[high]:
        high += 1
    rest = np.concatenate([score[:low], score[high + 1 :]])
    rival = float(np.max(rest, initial=0.0))
    confidence = float(np.clip(1.0 - rival / correlation, 0.0, 1.0)) if correlation > 0 else 0.0
    return ClockOffset(offset, correlation, confidence, reference.name, other.name)


def join_recordings(first: Recording, second: Recording, by: str) -> tuple[Recording, ClockOffset]:
    """Return one recording with the channels of both on the first clock, and the offset.

    `by` is a channel that both have (``"speed"``), or one of each (``"thrust:speed"``); of channels of one
    name the first recording's is kept where it has a value. A missing channel and an unsure offset are a
    LogError.
    """
    path = second.provenance.path
    name, _, other = by.partition(":")
    offset = find_offset(path, first[name], second[other or name], sign=not other)
    if not offset.sure:
        raise LogError(
            f"{path}: cannot be aligned with {first.provenance.path} by {by}: {offset.sentence()}; choose "
            "another channel or record a common event"
        )
    channels = dict(first.channels)
    added = []
    for key, channel in second.channels.items():
        if key not in channels or not channels[key].valid.any():
            channels[key] = Channel(key, channel.unit, channel.time + offset.offset, channel.values)
            added.append(key)
    sentence = (
        f"joined with {path} (SHA-256 {second.provenance.sha256}), which adds "
        f"{', '.join(added) or 'nothing'}; {offset.sentence()}"
    )
    notes = (*first.provenance.notes, note("logs-joined", sentence))
    return Recording(first.kind, channels, replace(first.provenance, notes=notes)), offset
