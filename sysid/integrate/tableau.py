"""Coefficients of the explicit Runge-Kutta pairs that the stepping loops use.

Both have order 3 with an error estimate of order 2 over five stages; the last stage of a step is the first of
the next one (row `STAGES` of `A` gives the step's end). The two coefficients that order 3 leaves in the
stability polynomial ``1 + z + z²/2 + z³/6 + c4 z⁴ + c5 z⁵`` are chosen for what limits the step. The other
free coefficients make three of the four conditions of order 4 hold within 1e-4 (c4 misses the fourth),
without negative weights in the sum; the estimate weighs the third-order terms by 1/12 and 1/24 and is as
small as possible where the polynomial is stable, so that stiff, settled motion does not shorten the steps.
Found by linear and nonlinear programming; the tests check every property.

`CREEPING`: the friction of a creeping foot is stiff and real. Below 0.95 in magnitude on the longest stretch
of the negative real axis, 10.4: four times as far as a three-stage pair of order 3 (2.5) for 5/3 of the work.

`RINGING`: a light leg between the body and stiff ground rings at a tenth to a half of critical damping and no
friction is stiff. Stable up to |z| = 4 there, where `CREEPING` reaches 3 and its estimate is twice as large
or more from |z| = 3 on.
"""

from typing import NamedTuple

import numpy as np

from sysid.types import FloatArray

STAGES = 5


class Pair(NamedTuple):
    """A pair of methods; the names are the ones under which the kernels' texts read it.

    `A` (6, 6), its square for second-order systems in Nystrom form, nodes `C` (6,), weights `E` (6,) of the
    error. The step is stable for what decays at a rate below `REAL_LIMIT` over the step. What decays as it
    rings, with rate ``z = -zeta + i sqrt(1 - zeta²)`` times its frequency, is stable up to the smaller one of
    RING_LIMIT + RING_GAIN zeta and RING_MOST - RING_FALL zeta.
    """

    A: FloatArray
    A_TWICE: FloatArray
    C: FloatArray
    E: FloatArray
    REAL_LIMIT: float
    RING_LIMIT: float
    RING_GAIN: float
    RING_MOST: float
    RING_FALL: float


def _pair(rows: list[list[float]], estimate: list[float], *limits: float) -> Pair:
    """Make a pair of the rows of the lower triangle."""
    a = np.zeros((STAGES + 1, STAGES + 1))
    for i, row in enumerate(rows, 1):
        a[i, :i] = row
    return Pair(a, a @ a, a.sum(axis=1), np.array(estimate), *limits)


# Its ringing is stable from below: exactly 2.23 undamped, 3.01 at 0.2.
CREEPING = _pair(
    [
        [0.19380001278980252],
        [0.282004305831376, 0.3054700909394164],
        [0.11680306715856152, 0.09601822703189825, 0.19681176345415474],
        [0.05320020800807128, 0.1387403794054382, 0.37911525931564893, 0.27558813881007044],
        [
            0.05899181939839189,
            0.2513071323988657,
            0.08377941464140332,
            0.25381858034657334,
            0.35210305321476576,
        ],
    ],
    [
        0.09714646292335849,
        0.17330145496135396,
        -0.1561220287184182,
        -0.2846391753206971,
        -0.02879704476650149,
        0.19911033092090435,
    ],
    10.4,
    2.2,
    4.0,
    3.0,
    0.0,
)
# Stable up to exactly 2.81 undamped, 4.01 at 0.1, 4.20 at 0.2, 3.92 at 0.5.
RINGING = _pair(
    [
        [0.31296080078244587],
        [2.433717011091381e-09, 0.2816361278244548],
        [0.19494301686520868, 0.07861747821447257, 0.38477898032715674],
        [0.07301425538081549, 0.08047911000469808, 0.2929965874819092, 0.38944268420128],
        [
            0.08129815051946632,
            0.2162078153862704,
            0.2525412004805686,
            0.08400974503989428,
            0.36594308857380053,
        ],
    ],
    [
        0.24824335804297892,
        -0.23543297936919674,
        -0.10672200818796829,
        0.047884317824026634,
        -0.15960894548992735,
        0.20563625718008702,
    ],
    3.2,
    2.8,
    12.0,
    4.2,
    1.0,
)
