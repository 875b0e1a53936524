"""Likely mistakes in writing down a campaign of drops: exchanged entries, a lost sign, a wrong height."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from sysid.campaign import GearCampaign
from sysid.campaign.swaps import Place, Swap
from sysid.trials.capture import CaptureFrame

# Entries that belong to a log: exchanged logs are exchanged slopes and places.
OF_LOG = {"log", "log_options", "rigid_body", "release", "touchdown"}
# The capture's axes, in the order of a point's components.
_AXES = "xyz"
# Component of an offset below which its sign tells nothing [m].
_LEAST = 1e-3
# Distances by which the height of feet, surface or centre of mass may be off [mm].
_OFF_BY = range(2, 41, 2)


def swaps(campaign: GearCampaign) -> Iterator[Swap]:
    """Yield the exchanges and lost signs that a campaign may contain."""
    for k, m in combinations(range(len(campaign.trials)), 2):
        one, other = campaign.trials[k], campaign.trials[m]
        names = f"of {one.name} and {other.name} exchanged"
        beside = {"name", "use", "slope", *OF_LOG}
        alike = one.model_dump(exclude=beside) == other.model_dump(exclude=beside)
        if None not in (one.slope, other.slope) and one.slope != other.slope:
            title = f"the slopes{' (or the logs)' if alike else ''} {names}"
            yield Swap(title, ((("trials", k, "slope"), ("trials", m, "slope")),))
        if not alike:
            pairs = tuple((("trials", k, key), ("trials", m, key)) for key in sorted(OF_LOG))
            yield Swap(f"the logs {names}", pairs)
    yield Swap("foot_dx and foot_dz exchanged", ((("vehicle", "foot_dx"), ("vehicle", "foot_dz")),))
    frame = CaptureFrame(campaign.capture.up, campaign.capture.down_slope)
    along, _, up = (int(np.argmax(np.abs(axis))) for axis in frame.matrix)
    offset: Place = ("capture", "centre_of_mass_offset")
    for k in (along, up):
        value = campaign.capture.centre_of_mass_offset[k]
        if abs(value) > _LEAST:
            yield Swap(f"the other sign of {_AXES[k]} in centre_of_mass_offset", negated=((*offset, k),))
    points = [offset] if any(campaign.capture.centre_of_mass_offset) else []
    points += [("surface", "point")] if campaign.surface.point is not None else []
    for point in points:
        for k, m in combinations(range(3), 2):
            title = f"{_AXES[k]} and {_AXES[m]} of {point[-1]} exchanged"
            yield Swap(title, (((*point, k), (*point, m)),))


def wrong_heights() -> Iterator[Swap]:
    """Yield heights that may be off."""
    for height in _OFF_BY:
        for sign, less, lower, higher in ((-1, "less", "lower", "higher"), (1, "more", "higher", "lower")):
            yield Swap(
                f"foot_dz about {height} mm {less}, or the surface as much {lower}, or the centre of mass as "
                f"much {higher}",
                moved=((("vehicle", "foot_dz"), sign * height / 1000),),
            )
