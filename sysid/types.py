"""Types that annotations share."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# Which way a motor turns, and which way a bench trial does.
Rotation = Literal["forward", "reverse"]
Direction = Literal["forward", "reverse", "reversal"]
