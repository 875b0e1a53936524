"""Formulas rewritten into fused multiply-adds: what is fused, what is left, and that it is rounded once."""

import platform
from fractions import Fraction

import numpy as np
import pytest
from numba import njit
from numba.core.codegen import get_host_cpu_features

from sysid.integrate.fused import fused_multiply_add, rewritten


@njit
@rewritten
def formulas(a, b, c, d):
    total = c
    total += a * b
    return a * b + c, c + a * b, c - a * b, a * b - c, a * b + c * d, a * b - c * d, total, -a * b - c


@njit
@rewritten
def places(work, row, lanes):
    return work[(row + 2 * lanes) * 1 + lanes] + 2.0 * work[row * lanes + 1]


def once(*terms):
    """The exact sum of products, rounded once."""
    return float(sum(Fraction(x) * Fraction(y) for x, y in terms))


@pytest.mark.skipif(
    "+fma" not in get_host_cpu_features() and platform.machine().lower() not in ("arm64", "aarch64"),
    reason="this CPU has no fused multiply-add",
)
def test_products_are_rounded_with_their_sum():
    source = np.random.default_rng(1)
    differs = 0
    for _ in range(200):
        a, b, c, d = source.normal(size=4)
        c = -a * b * (1 + 1e-9 * c)  # the product's lost digits show
        ab, cd = (a, b), (c, d)
        want = (
            once(ab, (c, 1.0)), once(ab, (c, 1.0)), once((c, 1.0), (-a, b)), once(ab, (c, -1.0)),
            # Two products that cancel must do so, in either order; in a difference the first is rounded.
            a * b + c * d, once((a * b, 1.0), (-c, d)),
            once(ab, (c, 1.0)), once((-a, b), (c, -1.0)),
        )  # fmt: skip
        assert formulas(a, b, *cd) == want
        differs += a * b + c != want[0]
    assert differs > 100


def test_places_of_rows_stay_whole():
    work = np.arange(20.0)
    assert places(work, 1, 2) == work[7] + 2.0 * work[3]

    @njit
    def mixed(x):
        return fused_multiply_add(2, x, 1), fused_multiply_add(2, 3, 4)

    assert mixed(0.25) == (1.5, 10)
