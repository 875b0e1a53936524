"""Arrays, directions and spectra: types that every room knows, free of heavy imports."""

from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# Which way a motor turns, and which way a bench trial does.
Rotation = Literal["forward", "reverse"]
Direction = Literal["forward", "reverse", "reversal"]
# Units of a command: pulses, numbers of DShot, shares of full command, hundredths of it.
CommandUnit = Literal["us", "dshot", "1", "%"]


class Compiled(Protocol):
    """A function that numba compiles, and its text in Python."""

    py_func: Any

    def __call__(self, *arguments: Any) -> Any: ...


@dataclass(frozen=True, eq=False)
class Spectrum:
    """How a signal is spread over frequency."""

    # (F,) increasing, logarithmically spaced where the signal is long enough [Hz].
    frequency: FloatArray
    # (F, C) amplitude spectral density of each channel [unit/√Hz].
    density: FloatArray
