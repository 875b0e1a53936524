"""What a campaign may tell a loader about its logs: every option of every format, checked before one is read.

`[log]` of a motor campaign and `[capture]` of a gear campaign hold for all logs whose format takes the
option; `log_options` of one trial holds for that trial's log, wins over them, and must fit its format.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from sysid.campaign.common import Angle, Frequency, Length, PositiveTime, Table
from sysid.errors import UnitError
from sysid.units import factor_to_si


def _known_unit(unit: str) -> str:
    # The unit of a command belongs to its protocol; what dimension a column has, its loader knows.
    if unit not in ("us", "µs", "dshot", "DShot", "1"):
        try:
            factor_to_si(unit)
        except UnitError as error:
            raise ValueError(str(error)) from error
    return unit


Unit = Annotated[str, AfterValidator(_known_unit)]


def _columns(value: Any) -> tuple[str, ...] | dict[str, str | int]:
    if isinstance(value, dict) and all(type(one) in (str, int) for one in value.values()):
        return value
    if isinstance(value, list | tuple) and all(isinstance(one, str) for one in value):
        return tuple(value)
    raise ValueError(
        'expected { speed = "tach" } (a new name and the one in the header, or its number), or a list of all '
        "names"
    )


Columns = Annotated[Any, BeforeValidator(_columns)]


class LogOptions(Table):
    """What is common to all logs."""

    format: str | None = None
    units: dict[str, Unit] | None = None
    columns: Columns | None = None
    time_back: Literal["refuse", "drop"] | None = None

    def stated(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Return the loader options that were given; an empty table is None and takes a statement back."""
        given = {name: getattr(self, name) for name in names}
        return {name: value or None for name, value in given.items() if value is not None}


class MotorAxes(Table):
    """`transform`: from the load cell's origin and axes to the motor's."""

    dx: Length = 0.0
    dy: Length = 0.0
    dz: Length = 0.0
    rx: Angle = 0.0
    ry: Angle = 0.0
    rz: Angle = 0.0

    def quantities(self) -> dict[str, str]:
        """Return the six as text with units, as loaders take them."""
        return {name: f"{value!r} {'m' if name[0] == 'd' else 'rad'}" for name, value in self}


class BenchLogOptions(LogOptions):
    """How a load-cell or thrust-stand file is read."""

    rate: Frequency | None = None
    datasets: dict[str, str] | None = None
    segment: int | None = Field(default=None, ge=1)
    static: bool | None = None
    pulses_per_revolution: float | None = Field(default=None, gt=0)
    calibration: str | None = None
    transform: MotorAxes | None = None
    tare: PositiveTime | None = None

    def loader_options(self) -> dict[str, Any]:
        """Return the options in the words of the loaders."""
        out = self.stated(
            ("units", "columns", "time_back", "rate", "datasets", "segment", "pulses_per_revolution",
             "calibration", "tare")
        )  # fmt: skip
        if self.transform is not None:
            out["transform"] = self.transform.quantities()
        if self.static is not None:
            out["static"] = self.static
        return out


class SecondLog(BenchLogOptions):
    """`second_log`: a file of the same run with its own clock, brought onto the first one's."""

    log: str = Field(min_length=1)
    align_by: str = Field(default="speed", pattern=r"^[^:]+(:[^:]+)?$")


class CaptureLogOptions(LogOptions):
    """How a motion-capture file is read."""

    rigid_body: str | None = None
    bodies: dict[str, tuple[str, ...]] | None = None
    topic: str | None = None
    quaternion_order: Literal["wxyz", "xyzw"] | None = None
    length_unit: Unit | None = None
    euler_order: str | None = None
    angles: str | None = None
    clock: Literal["auto", "frame", "time", "header", "arrival"] | None = None

    def loader_options(self) -> dict[str, Any]:
        """Return the options in the words of the loaders."""
        return self.stated(
            ("units", "columns", "time_back", "rigid_body", "bodies", "topic", "quaternion_order",
             "length_unit", "euler_order", "angles", "clock")
        )  # fmt: skip
