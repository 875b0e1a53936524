"""Thrust during a drop or a landing: two histories, and the instant at which their clock starts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from sysid.errors import CampaignError
from sysid.gear.kernel import work_buffer as at
from sysid.integrate.piecewise import PiecewiseCubic
from sysid.types import FloatArray


@dataclass(frozen=True, eq=False)
class Propulsion:
    """Thrust of the rear and front pair of motors [N], along the body's z axis at the two thrust points.

    Both have one clock; before the clock starts, the thrust has its first value.
    """

    rear: PiecewiseCubic
    front: PiecewiseCubic
    # Start of the clock since the drop's first sample [s], or when a foot first touches.
    begins: float | Literal["first contact"] = 0.0
    delay: float = 0.0  # of the clock behind the first contact [s]
    # Last command on the clock [s]: before it a body is not at rest, because its motors wait for a command.
    settled: float | None = None

    def __post_init__(self) -> None:
        known = self.begins == "first contact" if isinstance(self.begins, str) else np.isfinite(self.begins)
        if not (known and 0 <= self.delay < np.inf):
            raise CampaignError(
                f"propulsion: begins {self.begins!r} with a delay of {self.delay!r} s; give a time in "
                "seconds or 'first contact', and a delay of 0 or more"
            )

    def at(self, time: FloatArray, first_contact: float) -> FloatArray:
        """Return rear and front thrust (n, 2) [N] at times since the drop's start, given a first contact."""
        start = first_contact + self.delay if isinstance(self.begins, str) else self.begins
        elapsed = np.maximum(0.0, time - start) if np.isfinite(start) else np.zeros(np.shape(time))
        return np.column_stack([self.rear(elapsed), self.front(elapsed)])

    @cached_property
    def segments(self) -> FloatArray:
        """What the kernel reads (n, SEGMENT_COLUMNS): the value held before, the pieces, the last."""
        knots = np.unique(np.concatenate([[0.0], self.rear.knots, self.front.knots]))
        knots = knots[knots >= 0.0]
        out = np.zeros((len(knots) + 1, at.SEGMENT_COLUMNS))
        out[1:, at.SEGMENT_FROM] = knots
        out[1:, at.SEGMENT_TO] = [*knots[1:], np.inf]
        for column, history in ((at.SEGMENT_REAR, self.rear), (at.SEGMENT_FRONT, self.front)):
            out[1:-1, column : column + 4] = history.on(knots)
            out[0, column] = float(history(0.0))
            out[-1, column] = float(history(knots[-1]))
        return out


def plans(propulsion: Sequence[Propulsion | None]) -> tuple[FloatArray, FloatArray]:
    """Lay the drops' thrust into the kernel's arrays: all segments (n, SEGMENT_COLUMNS), plans (D, k) [SI].

    Drops that share a `Propulsion` share its segments.
    """
    tables: list[FloatArray] = [np.zeros((1, at.SEGMENT_COLUMNS))]
    places: dict[int, tuple[int, int]] = {}
    rows = []
    total = 1
    for thrust in propulsion:
        if thrust is None:
            rows.append([0, 1, np.inf, 1.0, -1.0])  # a start at infinity: no thrust, for ever
            continue
        if id(thrust) not in places:
            tables.append(thrust.segments)
            places[id(thrust)] = (total, total + len(thrust.segments))
            total += len(thrust.segments)
        waits = isinstance(thrust.begins, str)
        start = thrust.delay if waits else float(thrust.begins)
        settled = -1.0 if thrust.settled is None else thrust.settled
        rows.append([*places[id(thrust)], start, float(waits), settled])
    return np.concatenate(tables), np.array(rows, dtype=np.float64).reshape(-1, at.PLAN_COLUMNS)
