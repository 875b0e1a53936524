"""Why a simulated drop cannot be compared with a measured one, and what that costs a candidate.

A simulation that was lost has scored its penalty already (`sysid.fit.nrmse`). Two more kinds run to the end
but describe no drop that was measured: no foot ever touches, or the body slides off the board. Both keep
their NRMSE, on a surface that goes on for ever, and pay `FAILED_NRMSE` for the share of the window that is
missing: a candidate that comes nearer to the board, or leaves it later, scores less, and one that just
reaches the board's end pays nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.fit.nrmse import FilteredNrmse
from sysid.gear.drops import PreparedDrop
from sysid.gear.model import PopulationSamples, Status
from sysid.types import BoolArray, FloatArray

# In the order in which a candidate with several of them is counted. Too expensive: a contact or leg that is
# too stiff, or (on high friction mostly) too many bounces and mode switches.
CAUSES = ("blew_up", "too_expensive", "step_collapsed", "never_touched", "left_the_board")
_OF_STATUS = {Status.BLEW_UP: 1, Status.TOO_EXPENSIVE: 2, Status.STEP_COLLAPSED: 3}
_NEVER_TOUCHED, _LEFT_BOARD = 4, 5

# A candidate near the truth may cross the board's end a little before the measured body does, where the
# window ends: it counts as having left beyond this multiple of the board's length.
BEYOND_BOARD = 1.05


def lost_drops(
    cost: FilteredNrmse,
    drops: Sequence[PreparedDrop],
    board_length: float | None,
    result: PopulationSamples,
    samples: FloatArray,
    failed: BoolArray,
) -> tuple[NDArray[np.int8], FloatArray]:
    """Return why (from 1) each drop (P, D) is lost, 0: it is not, and which share of its window is missing.

    `samples` (P, n_total, 6) come from the simulation, with every drop's margins. Of a simulation that
    `failed` (P, D) nothing is missing: it has scored its penalty. The board ends this way down-slope of the
    touchdown [m]; None: nowhere.
    """
    cause = np.zeros(failed.shape, dtype=np.int8)
    for status, number in _OF_STATUS.items():
        cause[failed & (result.status == status)] = number
    # A share below 1 without a status is a trajectory that is not finite.
    cause[failed & (cause == 0)] = _OF_STATUS[Status.STEP_COLLAPSED]
    missing = np.zeros(failed.shape)
    touches = np.isfinite(result.first_contact).any(axis=2)
    missing[~touches] = 1.0
    cause[(cause == 0) & ~touches] = _NEVER_TOUCHED
    way = np.inf if board_length is None else BEYOND_BOARD * board_length
    feet = np.argmin(np.nan_to_num(result.first_contact, nan=np.inf), axis=2)
    for d, drop in enumerate(drops if way < np.inf else ()):
        first = int(cost.offsets[d]) + len(drop.before)
        # Two products beat the matrix product of a strided window.
        along = samples[:, first : first + len(drop.time), 0] * drop.feet.tangent[0]
        along += samples[:, first : first + len(drop.time), 1] * drop.feet.tangent[1]
        start = result.contact_state[np.arange(len(feet)), d, feet[:, d], :2] @ drop.feet.tangent
        beyond = along > (start + way)[:, None]
        share = np.where(beyond.any(axis=1), np.argmax(beyond, axis=1) / len(drop.time), 1.0)
        left = (cause[:, d] == 0) & (share < 1.0)
        missing[left, d] = 1.0 - share[left]
        cause[left, d] = _LEFT_BOARD
    missing[failed] = 0.0
    return cause, missing
