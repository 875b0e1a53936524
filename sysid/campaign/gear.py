"""Campaign of landing-gear drops: vehicle, motion capture, surface, window, filter, cost, trials."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from sysid.campaign.common import (
    CampaignTable,
    CostTable,
    FitTable,
    Frequency,
    Measured,
    PositiveLength,
    PositiveTime,
    Speed,
    Time,
    TomlTable,
    TrialTable,
    Weights,
)
from sysid.campaign.logs import CaptureLogOptions

CaptureAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
# How a place in the laboratory is found to 1 mm.
_Place = Annotated[float, Measured("m", "1 mm", "marker or ruler", "10 cm")]
Point = tuple[_Place, _Place, _Place]


def _slope_on_earth(value: float) -> float:
    if not 0.0 <= value < math.pi / 2:
        raise ValueError(
            f"a slope of {math.degrees(value):g} deg is outside 0 to 90 deg; down_slope sets its direction"
        )
    return value


def _nearly_level(value: float) -> float:
    if abs(value) > math.radians(10):
        raise ValueError(f"a tilt of {math.degrees(value):g} deg is beyond 10 deg; up names another axis")
    return value


# Standard error of a slope that states none.
SLOPE_ERROR = "0.2 deg"
Slope = Annotated[
    float, AfterValidator(_slope_on_earth), Measured("rad", SLOPE_ERROR, "inclinometer on the board", "5 deg")
]
_FootDistance = Annotated[float, Field(gt=0), Measured("m", "1 mm", "ruler from the centre of mass")]


class Vehicle(TomlTable):
    """`[vehicle]`: measured values of the drone, propellers on, as dropped. Feet from the centre of mass."""

    body_mass: Annotated[float, Field(gt=0), Measured("kg", "1 g", "kitchen scale")]
    body_inertia: Annotated[float, Field(gt=0), Measured("kg·m²", "3 %", "bifilar pendulum")]
    foot_dx: _FootDistance
    foot_dz: _FootDistance
    thrust_point_dx: PositiveLength | None = None
    leg_mass: Annotated[float, Field(gt=0), Measured("kg", "1 g", "kitchen scale")] | None = None
    leg_inertia: Annotated[float, Field(gt=0), Measured("kg·m²", "10 %", "a rod's, or CAD")] | None = None
    leg_mass_fraction: Annotated[float, Field(ge=0, le=1), Measured("1")] | None = None
    gravity: Annotated[float, Field(gt=0), Measured("m/s²")] = 9.81


class Capture(CaptureLogOptions):  # type: ignore[misc]
    """`[capture]`: how the motion capture names and orients things, and how its files are read."""

    up: CaptureAxis = "+y"
    down_slope: CaptureAxis = "+x"
    rate: Frequency | None = None
    # An offset that is left out is stated to be 0, with the typical error.
    centre_of_mass_offset: Point = Field(default=("0 m",) * 3, validate_default=True)
    # Angle by which what the capture calls up leans down-slope.
    tilt: Annotated[
        float,
        AfterValidator(_nearly_level),
        Measured("rad", "0.1 deg", "spirit level on the calibration square", "10 deg"),
    ] = Field(default="0 deg", validate_default=True)
    level: Literal["release", "capture"] = "release"

    @model_validator(mode="after")
    def _axes_differ(self) -> Capture:
        if self.up[1] == self.down_slope[1]:
            raise ValueError(
                f"up = {self.up!r} and down_slope = {self.down_slope!r} lie on one axis; name two axes"
            )
        return self


class SurfaceTable(TomlTable):
    """`[surface]`: the friction law and where the plane lies in the capture frame (one way of three)."""

    law: str = "lf"  # a declared friction law, resolved where the model is known
    kinetic_friction: Annotated[float, Field(gt=0, lt=5), Measured("1", "3 %", "tilted board")] | None = None
    static_friction_excess: Annotated[float, Field(ge=0, lt=5), Measured("1")] | None = None
    slip_regularization: Speed | None = None
    point: Point | None = None
    markers: tuple[str, ...] | None = None
    marker_height: _Place = Field(default="0 m", validate_default=True)
    rest_log: str | None = None
    board_length: PositiveLength | None = None

    @model_validator(mode="after")
    def _one_plane(self) -> SurfaceTable:
        ways = [k for k in ("point", "markers", "rest_log") if getattr(self, k) is not None]
        if len(ways) > 1:
            raise ValueError(f"the plane is given twice, by {' and '.join(ways)}; keep one")
        if self.markers is not None and not self.markers:
            raise ValueError("markers is empty; name at least one marker on the board")
        return self


class Window(TomlTable):
    """`[window]`: which part of a drop is compared."""

    before_contact: PositiveTime = 0.05
    after_contact: PositiveTime = 0.7
    max_gap: PositiveTime = 0.05


class KaiserFilter(TomlTable):
    """`[filter]`: the low-pass that both the recording and the simulation pass through."""

    kind: Literal["kaiser", "none"] = "kaiser"
    cutoff: Frequency = 65.0
    attenuation_db: float = Field(default=60.0, gt=8, lt=200)
    transition: Frequency = 10.0
    filter_simulation: bool = True


class GearWeights(Weights):
    """`[cost.weights]`: weight of each channel in a drop's mean."""

    x_B: float = Field(default=1.0, ge=0)
    z_B: float = Field(default=1.0, ge=0)
    x_B_rate: float = Field(default=1.0, ge=0)
    z_B_rate: float = Field(default=1.0, ge=0)
    q_B: float = Field(default=1.0, ge=0)


class GearCost(CostTable):
    """`[cost]`: the NRMSE."""

    weights: GearWeights = GearWeights()


class GearFitTable(FitTable):  # type: ignore[misc]
    """`[fit]`: the search, and how exactly a drop is simulated in it."""

    tolerance: float | None = Field(default=None, ge=1e-7, le=1e-2)


class GearTrial(TrialTable):
    """One drop: its log, the slope, and overrides where a drop differs from the campaign."""

    slope: Slope | None = None
    release: Annotated[float, Measured("s")] | None = None
    touchdown: Time | None = None
    rigid_body: str | None = None
    log_options: CaptureLogOptions = CaptureLogOptions()
    point: Point | None = None
    down_slope: CaptureAxis | None = None


class GearCampaign(CampaignTable):
    """Drops of one vehicle on one surface."""

    kind: Literal["gear"]
    vehicle: Vehicle
    capture: Capture = Capture()
    surface: SurfaceTable = SurfaceTable()
    window: Window = Window()
    filter: KaiserFilter = KaiserFilter()
    cost: GearCost = GearCost()
    fit: GearFitTable = GearFitTable()
    trials: tuple[GearTrial, ...]

    @model_validator(mode="after")
    def _every_drop_has_one_body_and_a_plane(self) -> GearCampaign:
        for trial in self.trials:
            if trial.rigid_body is not None and trial.log_options.rigid_body is not None:
                raise ValueError(
                    f"trial {trial.name!r}: rigid_body is given twice, in the trial and in its log_options; "
                    "keep one"
                )
            if trial.down_slope is not None and trial.down_slope[1] == self.capture.up[1]:
                raise ValueError(
                    f"trial {trial.name!r}: down_slope = {trial.down_slope!r} lies on the axis of "
                    f"up = {self.capture.up!r}; name another axis"
                )
            if trial.slope is None and (self.surface.markers is None or len(self.surface.markers) < 3):
                raise ValueError(
                    f"trial {trial.name!r} has no slope; give it, or name three surface.markers on the board"
                )
            if trial.point is None and not (
                self.surface.point is not None or self.surface.markers or self.surface.rest_log
            ):
                raise ValueError(
                    f"trial {trial.name!r}: nothing says where the surface lies (1 mm of height is 1.4 ms of "
                    f"touchdown); give surface.point, surface.markers or surface.rest_log"
                )
        return self
