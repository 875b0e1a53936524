"""The two low-pass filters of the paper, zero phase, and differentiation.

*Load cell and tachometer*: Chebyshev type II, order 10, 100 Hz, run forward and backward as second-order
sections. Forward-backward doubles order and attenuation. **The corner of a type II design is its stop-band
edge**, not its -3 dB point; `ChebyshevLowpass.cutoff_3db` states where the cascade really loses 3 dB.

*Motion capture*: linear-phase FIR, Kaiser window, one symmetric pass (zero phase by symmetry).

A sample that was not recorded stays masked: filters bridge a gap by a straight line, and never return the
bridged samples as valid. A simulated signal is bridged alike before it is compared, so both sides pass
through one linear operator.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy import signal

from sysid.errors import CampaignError, LogError
from sysid.types import BoolArray, FloatArray, Spectrum


@dataclass(frozen=True)
class _Lowpass(ABC):
    """What the filters share: refusals, gaps, and the design as a result states it."""

    KIND: ClassVar[str]
    REMEDY: ClassVar[str]

    # Sample rate [Hz].
    rate: float

    @property
    @abstractmethod
    def minimum_samples(self) -> int:
        """Shortest signal that can be filtered."""

    @abstractmethod
    def _filtered(self, values: FloatArray) -> FloatArray: ...

    def apply(self, values: FloatArray) -> FloatArray:
        """Filter (n,) or (n, k) along time; unknown samples, and those without a filtered value, are NaN.

        Raises LogError for fewer samples than the filter needs, or no valid one.
        """
        values = np.asarray(values, dtype=np.float64)
        if len(values) < self.minimum_samples:
            raise LogError(
                f"{len(values)} samples are fewer than the {self.minimum_samples} that the "
                f"{self.KIND.capitalize()} filter needs; record longer or {self.REMEDY}"
            )
        finite = np.isfinite(values)
        known = np.asarray(finite if values.ndim == 1 else finite.all(axis=1), dtype=np.bool_)
        if not known.any():
            raise LogError("no valid sample to filter; every sample is masked")
        out = self._filtered(values if known.all() else bridge_gaps(values, known))
        out[~known] = np.nan
        return out

    def design(self) -> dict[str, object]:
        """Return the design as a result states it: its kind, and the fields that define it."""
        arguments = {one.name: getattr(self, one.name) for one in fields(self) if one.init}
        return {"kind": self.KIND} | arguments


def stated_filter(design: Mapping[str, Any]) -> ChebyshevLowpass | KaiserLowpass | None:
    """Return the filter whose `design` a result states; None for any other."""
    for model in (ChebyshevLowpass, KaiserLowpass):
        if design.get("kind") == model.KIND:
            return model(**{one.name: design[one.name] for one in fields(model) if one.init})
    return None


@dataclass(frozen=True)
class ChebyshevLowpass(_Lowpass):
    """Zero-phase Chebyshev type II low-pass of a uniformly sampled signal.

    Valid when the signal is sampled at more than twice `stop_edge`; ignores clock jitter.

    References
    ----------
    Bass & Lussier Desbiens, Section II-A.2 ("tenth-order 100-Hz low-pass Chebyshev Type II").
    """

    KIND, REMEDY = "chebyshev", "switch the filter off"

    # Stop-band edge [Hz]; the paper's "100 Hz".
    stop_edge: float = 100.0
    # Order of one pass; the forward-backward cascade has twice as many poles.
    order: int = 10
    # Stop-band attenuation of one pass [dB], unprinted in the paper; the cascade has twice that.
    attenuation_db: float = 40.0
    sections: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 0 < self.stop_edge < self.rate / 2:
            raise CampaignError(
                f"Chebyshev filter: stop-band edge {self.stop_edge:g} Hz does not lie below half of the "
                f"sample rate {self.rate:g} Hz; lower the edge or leave the log unfiltered"
            )
        sections = signal.cheby2(
            self.order, self.attenuation_db, self.stop_edge, "low", output="sos", fs=self.rate
        )
        object.__setattr__(self, "sections", np.asarray(sections, dtype=np.float64))

    @property
    def edge_samples(self) -> int:
        """Samples at each end that the start of the recursion still colours (to 1e-3)."""
        poles = np.concatenate([np.roots(section[3:]) for section in self.sections])
        slowest = float(np.max(np.abs(poles)))
        return int(np.ceil(np.log(1e-3) / np.log(slowest)))

    @property
    def minimum_samples(self) -> int:
        """Shortest signal that can be filtered (the reflected padding of both ends must fit)."""
        return 3 * (2 * len(self.sections) + 1) + 1

    def gain(self, frequency: FloatArray) -> FloatArray:
        """Return the gain [1] of the forward-backward cascade at frequencies (n,) [Hz]."""
        _, response = signal.sosfreqz(self.sections, worN=np.asarray(frequency), fs=self.rate)
        return np.abs(response) ** 2

    @cached_property
    def cutoff_3db(self) -> float:
        """Frequency at which the forward-backward cascade has lost 3 dB [Hz]."""
        frequency = np.linspace(0.0, self.stop_edge, 20001)
        below = self.gain(frequency) < 10 ** (-3 / 20)
        return float(frequency[int(np.argmax(below))])

    def _filtered(self, values: FloatArray) -> FloatArray:
        return np.asarray(signal.sosfiltfilt(self.sections, values, axis=0), dtype=np.float64)

    def design(self) -> dict[str, object]:
        """Return the design as a result states it, and where the cascade loses 3 dB [Hz]."""
        return super().design() | {"cutoff_3db": round(self.cutoff_3db, 2)}


@dataclass(frozen=True)
class KaiserLowpass(_Lowpass):
    """Zero-phase linear-phase FIR low-pass of a uniformly sampled signal.

    Notes
    -----
    60 dB and 10 Hz at 200 Hz give 75 taps, i.e. 37 samples of edge at each end.

    References
    ----------
    Bass & Lussier Desbiens, Section II-D ("zero-phase 65-Hz low-pass Kaiser filter").
    """

    KIND, REMEDY = "kaiser", "widen its transition band"

    # Middle of the transition band, where half of the amplitude is left [Hz].
    cutoff: float = 65.0
    # Ripple and stop-band attenuation [dB], unprinted in the paper.
    attenuation_db: float = 60.0
    # Width of the transition band [Hz], unprinted in the paper.
    transition: float = 10.0
    taps: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 0 < self.cutoff < self.rate / 2:
            raise CampaignError(
                f"Kaiser filter: cut-off {self.cutoff:g} Hz does not lie below half of the sample rate "
                f"{self.rate:g} Hz; lower the cut-off or record faster"
            )
        count, beta = signal.kaiserord(self.attenuation_db, self.transition / (0.5 * self.rate))
        count += 1 - count % 2  # odd: symmetric about a sample, no half-sample shift
        taps = signal.firwin(count, self.cutoff, window=("kaiser", beta), fs=self.rate)
        object.__setattr__(self, "taps", np.asarray(taps, dtype=np.float64))

    @property
    def edge_samples(self) -> int:
        """Samples lost at each end: half of the taps."""
        return len(self.taps) // 2

    @property
    def minimum_samples(self) -> int:
        """Number of taps."""
        return len(self.taps)

    def gain(self, frequency: FloatArray) -> FloatArray:
        """Return the (real, signed) gain at `frequency` [Hz]."""
        offset = np.arange(len(self.taps)) - self.edge_samples
        phase = 2 * np.pi * np.asarray(frequency, dtype=np.float64)[..., None] * offset / self.rate
        return np.cos(phase) @ self.taps

    def _filtered(self, values: FloatArray) -> FloatArray:
        out, edge = np.full(values.shape, np.nan), self.edge_samples
        taps = self.taps if values.ndim == 1 else self.taps[:, None]
        out[edge : len(values) - edge] = signal.convolve(values, taps, mode="valid", method="direct")
        return out


def bridge_gaps(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return (n,) or (n, k) `values` with the masked samples on straight lines between their neighbours.

    Linear in the valid samples; constant before the first and after the last one.
    """
    index = np.arange(len(values), dtype=np.float64)
    out = values.reshape(len(values), -1).copy()
    for column in out.T:
        column[~valid] = np.interp(index[~valid], index[valid], column[valid])
    return out.reshape(values.shape)


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return start and stop of every run of True in a mask (n,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, dtype=np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


# Number of points of a spectrum.
_SPECTRUM_POINTS = 80
# Longest stretch that one estimate of a spectrum covers [s].
_SPECTRUM_STRETCH = 4.0
# Least number of samples in which noise shows.
_SHOWS = 20


def amplitude_spectrum(values: FloatArray, rate: float) -> Spectrum:
    """Return the amplitude spectral density [unit/√Hz] of (n, C) samples on a uniform clock, gaps bridged.

    A channel that is not finite throughout has none (NaN).

    Notes
    -----
    Welch's estimate (Hann window, linear trend removed), its power averaged in bands of equal ratio. White
    noise of standard deviation s has the density s sqrt(2/rate) at every frequency.
    """
    values = np.asarray(values, dtype=np.float64)
    length = min(len(values), max(256, int(_SPECTRUM_STRETCH * rate)))
    known = np.isfinite(values).all(axis=0)
    level = signal.detrend(np.where(known, values, 0.0), axis=0)
    frequency, power = signal.welch(level, rate, "hann", nperseg=length, axis=0)
    power[:, ~known] = np.nan
    frequency, power = frequency[1:], power[1:]
    edges = np.geomspace(frequency[0], frequency[-1] * (1 + 1e-9), _SPECTRUM_POINTS + 1)
    band = np.searchsorted(edges, frequency, side="right") - 1
    _, index, count = np.unique(band, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(index, column) / count for column in power.T])
    return Spectrum(np.bincount(index, frequency) / count, np.sqrt(mean))


def shown_noise(values: FloatArray, gain: float = 20.0) -> float:
    """Return the standard deviation of the noise of samples (n,) [their unit]; NaN where they show none.

    From the median third difference, in which a signal that is smooth most of the time leaves little; NaN
    among the samples is left out. `gain` is what a third difference makes of the noise's variance [1]: 20
    where it is white.
    """
    known = values[np.isfinite(values)]
    if len(known) < _SHOWS:
        return np.nan
    sigma = float(np.median(np.abs(np.diff(known, 3)))) / 0.6745 / np.sqrt(gain)
    return sigma if sigma > 0 else np.nan


def differentiate(values: FloatArray, rate: float) -> FloatArray:
    """Return the central difference of (n,) or (n, k) samples on a uniform clock [unit/s].

    Second-order accurate; the first and last sample, and those next to a NaN, are NaN.
    """
    values = np.asarray(values, dtype=np.float64)
    out = np.full(values.shape, np.nan)
    if len(values) > 2:
        out[1:-1] = (values[2:] - values[:-2]) * (0.5 * rate)
    return out
