"""`sysid new-campaign`: a campaign to fill in, whole, or with what a fit needs and what the logs say."""

import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader

from sysid.campaign.gear import SLOPE_ERROR
from sysid.campaign.logs import load_stated
from sysid.errors import CampaignError, SysidError, shell
from sysid.loaders import formats
from sysid.loaders.options import DECLARED
from sysid.recording import Recording
from sysid.storage import check_file, write_file
from sysid.trials.look import LogReport, inspect_recording
from sysid.workflows.inspect import toml_value

# Kinds of logs that a kind of campaign takes, and the words that ask for them.
_RECORDED = {
    "gear": ({"motion-capture"}, "drops under motion capture"),
    "motor": ({"thrust-stand", "load-cell", "static-map"}, "a motor on a thrust stand or load cell"),
}
# Commands of a usual speed controller [µs], and shares of the full one, such as a duty [1], [%].
_RANGES = {
    "us": {"minimum": 1000, "neutral": 1500, "maximum": 2000},
    "1": {"minimum": -1, "neutral": 0, "maximum": 1},
    "%": {"minimum": -100, "neutral": 0, "maximum": 100},
}  # fmt: skip
# Largest distance from rest, over that of full command [1], that a log of one direction keeps on the other
# side.
_NEAR_REST = 0.04
# Least share [1] of the largest thrust among the logs; a log with less was taken without propeller.
_NO_THRUST = 0.02
_TODO = "TODO"
# Row of a campaign that is written without logs.
_BLANK = {
    "name": "trial-1", "file": f"{_TODO}.csv", "slope": f"{_TODO} ± {SLOPE_ERROR}", "direction": _TODO,
    "points": "",
}  # fmt: skip


def write_new_campaign(
    kind: str,
    path: Path,
    logs: Sequence[Path] = (),
    *,
    minimal: bool = False,
    options: Mapping[str, object] | None = None,
    force: bool = False,
) -> Path:
    """Write a commented campaign file; with logs, or a `minimal` one, only what a fit needs.

    What logs say is filled in: names, slopes, axes, directions, commands. What they do not say stands there
    as TODO, which no command accepts. The logs are read with those loader `options` that their formats take,
    and the campaign states the options. Raises `SysidError` when the file exists and `force` is off, an
    option is for none of the logs, or a log cannot be read or is of another kind; nothing has been written
    then.
    """
    options = dict(options or {})
    form = str(options.pop("format", "auto"))
    check_file(path, force=force, error_type=CampaignError)
    if minimal or logs:
        environment = Environment(loader=PackageLoader("sysid", "templates"), autoescape=False)
        reports: list[LogReport] = []
        ways: list[str] = []
        supply = np.zeros(0)
        kinds, wanted = _RECORDED[kind]
        for log in logs:
            try:
                recording = load_stated(log, form, options, {})
            except SysidError as error:
                if not error.needs:
                    raise
                hint = f"sysid inspect {shell(log)} shows all that is missing"
                raise type(error)(f"{error}; {hint}") from error
            report = inspect_recording(recording)
            if report.kind not in kinds:
                beside = (
                    " or join it to the stand's with sysid convert --add" if report.kind == "signals" else ""
                )
                found = "holds single signals" if report.kind == "signals" else f"is a {report.kind} log"
                raise CampaignError(
                    f"{log}: {found}; a {kind} campaign needs {wanted}, so leave this log out{beside}"
                )
            reports.append(report)
            ways.append(_one_way(recording))
            if report.kind != "static-map" and (volts := recording.channels.get("voltage")) is not None:
                supply = np.append(supply, volts.values[volts.valid])
        taken = {option for report in reports for option in formats()[report.format].options}
        if idle := sorted(set(options) - taken):
            raise CampaignError(
                f"option {idle[0]!r} is for none of these logs; their formats take {', '.join(sorted(taken))}"
            )
        body = options.pop("rigid_body", None)
        stated = ({} if form == "auto" else {"format": form}) | options
        lines = [f"{name} = {toml_value(_with_unit(name, value))}" for name, value in stated.items()]
        content = _content(kind, path, reports, ways) | {"options": lines}
        content["body"] = body or content["body"]
        # A fit takes the same median where a campaign does not state the supply.
        if supply.size and (middle := float(np.median(supply))) > 0:
            content |= {"voltage": f"{middle:.4g} V", "voltage_from": "median of the logged supply voltage"}
        text = environment.get_template(f"{kind}-minimal.toml").render(content) + "\n"
    else:
        text = resources.files("sysid").joinpath("templates", f"{kind}.toml").read_text(encoding="utf-8")
    write_file(path, text.encode("utf-8"), CampaignError)
    return path


def _content(kind: str, path: Path, reports: Sequence[LogReport], ways: Sequence[str]) -> dict[str, object]:
    """Return what the template of a kind is filled with; `ways` has what `_one_way` says of each report."""
    drops = [report.drop for report in reports if report.drop is not None]
    most = max((_span(report, "thrust") for report in reports), default=0.0)
    units = {channel.unit for report in reports for channel in report.channels if channel.name == "command"}
    volts = [
        channel.highest
        for report in reports
        for channel in report.channels
        if report.kind == "static-map" and channel.name == "voltage" and math.isfinite(channel.highest)
    ]
    # Only a log that begins at the middle says that the motor turns both ways; a share has a sign.
    both = any(ways) or units == {"1"}
    logs = []
    for report, way in zip(reports, ways, strict=True):
        slope = report.drop.slope if report.drop else None
        curve = "no_load" if _span(report, "thrust") < _NO_THRUST * most else "static"
        source = Path(report.path)
        logs.append({
            "name": source.stem,
            "file": Path(os.path.relpath(source, path.parent)).as_posix(),
            "slope": f"{_TODO if slope is None else f'{math.degrees(slope):.1f}'} ± {SLOPE_ERROR}",
            "direction": way or ("reversal" if both else "forward"),
            "points": curve if report.kind == "static-map" else "",
        })  # fmt: skip
    numbers: dict[str, object] = dict.fromkeys(_RANGES["us"], f'"{_TODO}"')
    known = len(units) == 1 and units <= {*_RANGES}
    if known:
        numbers |= _RANGES[next(iter(units))]
    return {
        "name": re.sub(r"[^A-Za-z0-9._-]+", "-", path.stem).strip(".-") or f"my-{kind}",
        "body": _usual(drop.body for drop in drops),
        "up": _usual(drop.up for drop in drops),
        "down_slope": _usual(drop.down_slope for drop in drops),
        "voltage": f"{max(volts):.3g} V" if volts else f"{_TODO} V",
        "voltage_from": "supply at which the static logs were taken",
        "unit": _usual(units),
        **numbers,
        "neutral": numbers["neutral"] if both or units != {"us"} else None,
        "logs": logs or [_BLANK],
    }


def _with_unit(name: str, value: object) -> object:
    """Return the value of a loader option with the option's unit, which a campaign wants."""
    unit = DECLARED[name].unit if name in DECLARED else ""
    return f"{value} {unit}" if unit and not isinstance(value, str) else value


def _one_way(recording: Recording) -> str:
    """Return which way a motor turns whose command stays on one side of the middle; else an empty text."""
    command = recording.channels.get("command")
    if command is None or command.unit not in _RANGES or not command.valid.any():
        return ""
    levels, ends = command.values[command.valid], _RANGES[command.unit]
    rest, near = ends["neutral"], _NEAR_REST * (ends["maximum"] - ends["neutral"])
    if levels.min() > rest - near or levels.max() >= rest + near:
        return "forward" if levels.min() > rest - near else ""
    # A rotor of one direction at half throttle turns faster under higher commands.
    speed = recording.channels.get("speed")
    if speed is None or not speed.valid.any():
        return "reverse"
    size = np.abs(np.interp(command.time[command.valid], speed.time[speed.valid], speed.values[speed.valid]))
    return "" if np.cov(levels, size)[0, 1] > 0 else "reverse"


def _span(report: LogReport, name: str) -> float:
    return sum(channel.highest - channel.lowest for channel in report.channels if channel.name == name)


def _usual(words: Iterable[str | None]) -> str:
    """Return the most frequent word, or the placeholder where there is none."""
    found = Counter(word for word in words if word).most_common(1)
    return found[0][0] if found else _TODO
