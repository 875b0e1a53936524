"""The drone's impact detection: accelerometer, low-pass, threshold (section III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.errors import CampaignError
from sysid.types import FloatArray

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Sensing:
    """An accelerometer at the body's centre of mass that looks for an impact.

    Parameters
    ----------
    threshold : float
        Magnitude of the filtered specific force at which an impact is seen [m/s²]; 2 g. Hovering reads 1 g.
    rate : float
        Samples per second [Hz].
    corner : float
        -3 dB corner of the low-pass, Butterworth, causal [Hz].
    order : int
        Of the low-pass.
    window : float
        An impact is looked for during this time after touchdown [s].

    Notes
    -----
    The filter's delay (about 11 ms at 30 Hz) is part of the reaction time. A gentle touchdown may stay below
    the threshold: then nothing triggers, as on the real drone. Until then the motors keep the hover command.
    Without attitude control that says nothing after some tenths of a second, hence the window.
    """

    threshold: float = 2.0 * STANDARD_GRAVITY
    rate: float = 1000.0
    corner: float = 30.0
    order: int = 3
    window: float = 0.5

    def __post_init__(self) -> None:
        if not (
            self.threshold > 0 and self.window > 0 and 0 < 2 * self.corner < self.rate and self.order >= 1
        ):
            raise CampaignError(
                f"sensing: threshold {self.threshold:g} m/s², rate {self.rate:g} Hz, corner "
                f"{self.corner:g} Hz, order {self.order}; expected a corner below half the rate"
            )

    def filtered(self, specific_force: FloatArray) -> FloatArray:
        """Return the low-passed magnitude (n,) [m/s²] of samples (n, 2) at `rate`, settled on the first."""
        from scipy.signal import butter, sosfilt, sosfilt_zi

        sos = butter(self.order, self.corner, fs=self.rate, output="sos")
        settled = sosfilt_zi(sos)
        parts = (sosfilt(sos, force, zi=settled * force[0])[0] for force in specific_force.T)
        return np.asarray(np.hypot(*parts))

    def trigger(self, specific_force: FloatArray) -> float:
        """Return when an impact is seen in specific forces (n,) [m/s²], from sample 0 on [s]; NaN: never."""
        above = np.flatnonzero(self.filtered(specific_force) > self.threshold)
        return float(above[0] / self.rate) if len(above) else float("nan")
