"""What a campaign may state about its logs, checked before one is read, and the loading of logs with it.

`[log]` of a motor campaign and `[capture]` of a gear campaign count for all logs whose format takes
the option; `log_options` of a trial counts for its log, wins over them, and must fit its format.
`sysid.loaders.options` declares the options and their checks; options of installed plug-in formats may be
stated too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)

from sysid.campaign.common import Angle, Length, TomlTable
from sysid.journal import notice
from sysid.loaders import detect, formats, load
from sysid.loaders.options import BenchOptions, CaptureOptions, LogOptions, known_unit
from sysid.loaders.registry import plug_in_options
from sysid.recording import Recording

Unit = Annotated[str, AfterValidator(known_unit)]


# A frozen model may inherit a frozen dataclass, but mypy takes a model for a dataclass that is not frozen.
class LogTable(TomlTable, LogOptions):  # type: ignore[misc]
    """What is common to all logs. An option of a plug-in format is passed on unchanged."""

    model_config = ConfigDict(extra="allow")

    format: str | None = None

    @model_validator(mode="wrap")
    @classmethod
    def _closed(cls, data: object, handler: ModelWrapValidatorHandler[LogTable]) -> LogTable:
        if isinstance(data, dict) and not data.keys() <= cls.model_fields.keys():
            known = {*cls.model_fields, *plug_in_options()}
            errors = [
                {"type": "extra_forbidden", "loc": (key,), "input": value}
                for key, value in data.items()
                if key not in known
            ]
            if errors:
                raise ValidationError.from_exception_data(cls.__name__, errors)  # type: ignore[arg-type]
        return handler(data)

    def loader_options(self) -> dict[str, object]:
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

    def loader_options(self) -> dict[str, object]:
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


def load_stated(
    path: Path, format_name: str | None, stated: Mapping[str, object], for_log: Mapping[str, object]
) -> Recording:
    """Load a log with those options `stated` in the campaign that its format takes; None is not stated.

    A campaign may mix formats: a quaternion order is for its pose tables, not for its Motive exports. What is
    stated `for_log` alone must fit its format; it wins, and None takes a statement of the campaign back. The
    format is judged by content where `format_name` is None or ``"auto"``.
    """
    if format_name is None or format_name == "auto":
        format_name = detect(path)
    known = formats()
    takes = known[format_name].options if format_name in known else ()
    options = {name: stated[name] for name in takes if name in stated} | dict(for_log)
    return load(path, format=format_name, **options)


def warn_of_idle_options(
    table: str, stated: Mapping[str, object], logs: Iterable[tuple[Path, str | None]]
) -> None:
    """Warn of options of a campaign's `table` (all of them: `stated`) that no format of its `logs` takes."""
    named = {detect(path) if name in (None, "auto") else str(name) for path, name in logs}
    known = formats()
    taken = {option for name in named if name in known for option in known[name].options}
    for option in sorted({name for name, value in stated.items() if value is not None} - taken):
        near = ", ".join(name for name, format_of in known.items() if option in format_of.options)
        notice(
            "idle-log-option",
            f"{table}.{option} has no effect: the logs are {', '.join(sorted(named))}, and it is for {near}; "
            "leave it out, or name the format",
        )
