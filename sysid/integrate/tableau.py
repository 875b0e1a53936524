"""Coefficients of the explicit Runge-Kutta pair that the stepping loops use.

Order 3 with an error estimate of order 2 over five stages; the last stage of a step is the first of the next
one (row `STAGES` of `A` gives the step's end). The stability polynomial ``1 + z + z²/2 + z³/6 + c4 z⁴ + c5
z⁵`` is the one that stays below 0.95 in magnitude on the longest stretch of the negative real axis,
`REAL_LIMIT` = 10.4: four times as far as a three-stage pair of order 3 (2.5) for 5/3 of the work, because the
friction of a creeping foot is stiff and real. The free coefficients make the order conditions of order 4 hold
within 1e-4, without negative weights in the sum; the estimate weighs the third-order terms by 1/12 and 1/24
and is as small as possible on that stretch, so that stiff, settled motion does not shorten the steps. Found
by linear and nonlinear programming; the tests check every property.

`A_TWICE = A A` serves second-order systems in Nystrom form.
"""

import numpy as np

STAGES = 5
REAL_LIMIT = 10.4
# A decaying oscillation, of rate ``z = -zeta + i sqrt(1 - zeta²)`` times its frequency, is stable up to |z| =
# RING_LIMIT + RING_GAIN zeta, at most RING_MOST (rounded down: exactly 2.23 undamped, 3.01 at 0.2).
RING_LIMIT = 2.2
RING_GAIN = 4.0
RING_MOST = 3.0
A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.19380001278980252, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.282004305831376, 0.3054700909394164, 0.0, 0.0, 0.0, 0.0],
        [0.11680306715856152, 0.09601822703189825, 0.19681176345415474, 0.0, 0.0, 0.0],
        [0.05320020800807128, 0.1387403794054382, 0.37911525931564893, 0.27558813881007044, 0.0, 0.0],
        [
            0.05899181939839189,
            0.2513071323988657,
            0.08377941464140332,
            0.25381858034657334,
            0.35210305321476576,
            0.0,
        ],
    ]
)
A_TWICE = A @ A
C = A.sum(axis=1)
E = np.array(
    [
        0.09714646292335849,
        0.17330145496135396,
        -0.1561220287184182,
        -0.2846391753206971,
        -0.02879704476650149,
        0.19911033092090435,
    ]
)
