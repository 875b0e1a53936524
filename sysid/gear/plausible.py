"""What a campaign states, beside what its logs show and what a vehicle can be."""

import numpy as np

from sysid.campaign import GearCampaign, GearTrial
from sysid.errors import CampaignError
from sysid.journal import notice
from sysid.trials.capture import CaptureFrame, signed_axis
from sysid.trials.look import DropReport

# Largest difference of two slopes that is no contradiction [rad], by markers: an inclinometer and three
# markers at least 0.3 m apart, placed to 1 mm, agree to 0.3 deg; the sample drops agree to 0.005 deg.
_BY_MARKERS = np.radians(0.5)
# The same by the tilt at rest [rad]: the body leans on bent legs.
_BY_REST = np.radians(10.0)
# Least slope of a board that shows a direction [rad].
_SHALLOW = np.radians(2.0)
# Limits of sqrt(I/m) over the distance of a foot [1]; the F450 of the paper has 0.57, a rod of that length
# 0.58. Masses and inertias off by a factor of ten are outside.
_GYRATION = (0.3, 1.2)
# Limits of the mass over the cube of that distance [kg/m³]: the F450 has 200, a solid stone ten times that.
_DENSITY = (30.0, 1200.0)
# Distance of the thrust from the centre of mass, as a share of the feet's [1]; the F450's.
_THRUST_POINT = 0.86
# Mass of a pair of legs, as a share of the body's [1]; the F450's.
_LEG_MASS = 0.016
# Inertia of a pair of legs over the body's mass and the square of the feet's distance [1]; the F450's.
_LEG_INERTIA = 0.0048
# Length of a board, as a multiple of the feet's distance [1].
_BOARD = 5.0

# Factor beyond these limits that only a wrong unit explains [1].
_ABSURD = 10.0


def notice_contradictions(campaign: GearCampaign, trial: GearTrial, seen: DropReport | None) -> None:
    """Notice where a log shows another slope [rad], axis or falling body than the campaign states."""
    if seen is None:
        return
    if trial.slope is not None and seen.slope is not None:
        shown = seen.slope + (capture_frame(campaign, trial).tilt if seen.slope_by_markers else 0.0)
        notice_slope(trial.name, trial.slope, shown, seen.slope_by_markers)
    capture = campaign.capture
    if seen.up != capture.up:
        _notice(trial.name, "up", f'"{capture.up}"', f'"{seen.up}"')
    down_slope = trial.down_slope or capture.down_slope
    steep = min(seen.slope or 0.0, np.inf if trial.slope is None else trial.slope) > _SHALLOW
    if seen.down_slope and not seen.down_slope_doubt and steep and seen.down_slope != down_slope:
        _notice(trial.name, "down-slope", f'"{down_slope}"', f'"{seen.down_slope}"')
    body = trial.rigid_body or trial.log_options.rigid_body or capture.rigid_body
    if body not in (None, seen.body):
        _notice(trial.name, "rigid-body", f'"{body}"', f'that "{seen.body}" falls')


def capture_frame(campaign: GearCampaign, trial: GearTrial) -> CaptureFrame:
    """Return the axes in which a drop was captured; their tilt is stated along the campaign's down_slope."""
    capture = campaign.capture
    down_slope = trial.down_slope or capture.down_slope
    along = float(signed_axis(down_slope) @ signed_axis(capture.down_slope))
    return CaptureFrame(capture.up, down_slope, along * capture.tilt)


def notice_slope(trial: str, stated: float, shown: float, by_markers: bool = True) -> None:
    """Notice where a log shows another slope than the one that the campaign states [rad].

    As exact as its sentence, so that a slope by named markers and one by all markers is noticed once.
    """
    if abs(shown - stated) > (_BY_MARKERS if by_markers else _BY_REST):
        how = "from markers" if by_markers else "from the tilt at rest"
        _notice(
            trial, "slope", f"{np.degrees(stated):.1f} deg", f"{np.degrees(shown):.1f} deg {how}",
            size=float(np.round(np.degrees(abs(shown - stated)), 1)),
        )  # fmt: skip


def _notice(trial: str, what: str, stated: str, shown: str, size: float = 0.0) -> None:
    notice(
        f"contradicts-{what}",
        f"the campaign states {what.replace('-', '_')} = {stated}, the log shows {shown}: one of both is "
        "wrong; sysid inspect prints what the log shows",
        trial=trial,
        size=size,
    )


def notice_odd_vehicle(campaign: GearCampaign) -> None:
    """Notice a mass or an inertia that no vehicle of that size has.

    CampaignError where it is `_ABSURD` times beyond what vehicles have: that is a slip of a unit.
    """
    vehicle = campaign.vehicle
    mass, inertia = vehicle.body_mass, vehicle.body_inertia
    if mass is None or inertia is None:
        return
    size = float(np.hypot(vehicle.foot_dx, vehicle.foot_dz))
    gyration, density = float(np.sqrt(inertia / mass)), mass / size**3
    _hold(
        "odd-inertia", (gyration / size) ** 2, (_GYRATION[0] ** 2, _GYRATION[1] ** 2),
        f"sqrt(body_inertia/body_mass) = {1e3 * gyration:.0f} mm is {gyration / size:.2g} of the feet's "
        f"distance from the centre of mass ({1e3 * size:.0f} mm); vehicles have {_GYRATION[0]:g} to "
        f"{_GYRATION[1]:g}: check body_mass ({mass:.4g} kg), body_inertia ({inertia:.4g} kg·m²), "
        "foot_dx, foot_dz and their units",
    )  # fmt: skip
    _hold(
        "odd-mass", density, _DENSITY,
        f"body_mass = {mass:.4g} kg with feet {1e3 * size:.0f} mm from the centre of mass is "
        f"{density:.3g} kg/m³; vehicles have {_DENSITY[0]:g} to {_DENSITY[1]:g}: check the mass, the "
        "lengths and their units",
    )  # fmt: skip
    for name, value, usual, most in (
        ("thrust_point_dx", vehicle.thrust_point_dx, _THRUST_POINT * size, 10.0),
        ("leg_mass", vehicle.leg_mass, _LEG_MASS * mass, 50.0),
        ("leg_inertia", vehicle.leg_inertia, _LEG_INERTIA * mass * size**2, 50.0),
        ("board_length", campaign.surface.board_length, _BOARD * size, 50.0),
    ):
        if value is not None:
            ratio = float(f"{value / usual:.2g}")
            _hold(
                f"odd-{name.replace('_', '-')}", value / usual, (1 / most, most),
                f"{name} = {value:.4g} is {ratio:g} × what a vehicle of this mass and size has (about "
                f"{usual:.2g}): check the value and its unit",
            )  # fmt: skip


def _hold(code: str, value: float, usual: tuple[float, float], sentence: str) -> None:
    """Notice a value outside of what is usual; refuse one far outside."""
    if not usual[0] / _ABSURD <= value <= usual[1] * _ABSURD:
        raise CampaignError(sentence)
    if not usual[0] <= value <= usual[1]:
        notice(code, sentence)
