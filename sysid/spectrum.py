"""The spectrum of a signal as results keep it, apart from the filters, whose import takes a second."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.types import FloatArray


@dataclass(frozen=True, eq=False)
class Spectrum:
    """How a signal is spread over frequency, in few enough points to be kept with a result.

    Parameters
    ----------
    frequency : (F,) array
        Increasing, logarithmically spaced where the signal is long enough [Hz].
    density : (F, C) array
        Amplitude spectral density of each channel [unit/√Hz].
    """

    frequency: FloatArray
    density: FloatArray
