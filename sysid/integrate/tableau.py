"""Coefficients of the explicit Runge-Kutta pair that the stepping loops use.

Bogacki and Shampine, order 3(2): the last stage of a step is the first of the next one. Row `STAGES` of `A` gives the
step's end. `A_TWICE = A A` serves second-order systems in Nystrom form; `E` is the error estimate, third minus second
order.

References
----------
P. Bogacki, L. F. Shampine, A 3(2) pair of Runge-Kutta formulas, Appl. Math. Lett. 2 (1989) 321-325.
"""

import numpy as np

STAGES = 3
A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [1 / 2, 0.0, 0.0, 0.0],
        [0.0, 3 / 4, 0.0, 0.0],
        [2 / 9, 1 / 3, 4 / 9, 0.0],
    ]
)
A_TWICE = A @ A
C = A.sum(axis=1)
E = np.array([-5 / 72, 1 / 12, 1 / 9, -1 / 8])
