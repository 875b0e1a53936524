"""What every thrust-stand log shares: which speed to trust, and averaged points against a running log."""

from __future__ import annotations

import numpy as np

from sysid.journal import Finding, note
from sysid.recording import FloatArray

# Running logs of these stands step by 8 to 50 ms, averaged points by 0.45 to 5 s (measured on real logs).
_STATIC_STEP = 0.2


def is_static(time: FloatArray) -> bool:
    """Return whether rows are averaged points.

    Half of them or more lie over 0.2 s from the next, either way.
    """
    known = time[np.isfinite(time)]
    return known.size > 1 and float(np.median(np.abs(np.diff(known)))) >= _STATIC_STEP


def choose_speed(
    optical: FloatArray | None, electrical: FloatArray | None
) -> tuple[FloatArray | None, list[Finding]]:
    """Return the speed to use [rad/s] and notes: the optical one unless it is off.

    A probe that is off writes zeros. Where both run and differ by one constant ratio, the pole count set in
    the stand's program is wrong: a warning says so, and nothing is averaged.
    """

    def running(speed: FloatArray | None) -> int:
        return 0 if speed is None else int(np.count_nonzero(np.nan_to_num(speed)))

    seen_optical, seen_electrical = running(optical), running(electrical)
    if optical is None or seen_optical < 0.5 * seen_electrical:
        if electrical is None:
            return None, []
        off = "" if optical is None else "; the optical probe reads zero"
        return electrical, [note("electrical-speed", f"speed is the electrical one{off}")]
    if electrical is None or not seen_electrical:
        off = "; the electrical probe reads zero" if seen_optical and electrical is not None else ""
        return optical, [note("optical-speed", f"speed is the optical one{off}")]
    notes = [note("optical-speed", "speed is the optical one")]
    both = (np.nan_to_num(optical) != 0) & (np.nan_to_num(electrical) != 0)
    if both.sum() >= 3:
        ratio = electrical[both] / optical[both]
        middle = float(np.median(ratio))
        low, high = np.percentile(ratio, [25, 75])
        # One pole pair of fourteen is 7 %; probes that agree differ by well under 2 %.
        if abs(middle - 1.0) > 0.02 and high - low < 0.02 * abs(middle):
            sentence = (
                f"electrical speed is {middle:.4g} times the optical one throughout: "
                "the pole count set in the stand's program is probably wrong"
            )
            notes.append(Finding("pole-count", sentence))
    return optical, notes
