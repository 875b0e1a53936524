"""What a campaign may state about its logs: every option of every format, checked before one is read.

`[log]` of a motor campaign and `[capture]` of a gear campaign count for all logs whose format takes
the option; `log_options` of a trial counts for its log, wins over them, and must fit its format.
`sysid.loaders.options` declares the options and their checks; options of installed plug-in formats may be
stated too.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)

from sysid.campaign.common import Angle, Length, TomlTable
from sysid.loaders.options import BenchOptions, CaptureOptions, LogOptions, known_unit
from sysid.loaders.registry import plug_in_options

Unit = Annotated[str, AfterValidator(known_unit)]


# A frozen model may inherit a frozen dataclass, but mypy takes a model for a dataclass that is not frozen.
class LogTable(TomlTable, LogOptions):  # type: ignore[misc]
    """What is common to all logs. An option of a plug-in format is passed on unchanged."""

    model_config = ConfigDict(extra="allow")

    format: str | None = None

    @model_validator(mode="wrap")
    @classmethod
    def _closed(cls, data: Any, handler: ModelWrapValidatorHandler[LogTable]) -> LogTable:
        unknown = [key for key in data if key not in cls.model_fields] if isinstance(data, dict) else []
        if unknown:
            allowed = plug_in_options()
            errors = [
                {"type": "extra_forbidden", "loc": (key,), "input": data[key]}
                for key in unknown
                if key not in allowed
            ]
            if errors:
                raise ValidationError.from_exception_data(cls.__name__, errors)  # type: ignore[arg-type]
        return handler(data)

    def loader_options(self) -> dict[str, Any]:
        """Return the declared options in the words of the loaders."""
        return self.declared() | (self.model_extra or {})


class MotorAxes(TomlTable):
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


class BenchLogOptions(LogTable, BenchOptions):  # type: ignore[misc]
    """How a load-cell or thrust-stand file is read."""

    transform: MotorAxes | None = None

    def loader_options(self) -> dict[str, Any]:
        """Return the declared options in the words of the loaders."""
        transform = {} if self.transform is None else {"transform": self.transform.quantities()}
        return super().loader_options() | transform


class SecondLog(BenchLogOptions):  # type: ignore[misc]
    """`second_log`: a file of the same run with another clock, brought onto the first."""

    log: str = Field(min_length=1)
    align_by: str = Field(default="speed", pattern=r"^[^:]+(:[^:]+)?$")


class CaptureLogOptions(LogTable, CaptureOptions):  # type: ignore[misc]
    """How a motion-capture file is read."""

    rigid_body: str | None = None
