"""What a log holds, in words and figures, and its conversion: the commands `inspect` and `convert`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sysid.errors import CampaignError, LogError, SysidError
from sysid.loaders import formats, load
from sysid.loaders.alignment import join_recordings
from sysid.loaders.readers.sysid_hdf5 import write_recording
from sysid.recording import Recording
from sysid.report.fold import print_table
from sysid.trials.look import BenchReport, ChannelReport, DropReport, LogReport, inspect_recording

_MOST_ROWS = 40


def parse_options(given: Sequence[str]) -> dict[str, Any]:
    """Return loader options from ``name=value`` words; values are TOML, bare words are text.

    Raises
    ------
    CampaignError
        When a word has no ``=``.
    """
    import tomllib

    options: dict[str, Any] = {}
    for word in given:
        name, equals, value = word.partition("=")
        if not equals or not name.strip():
            raise CampaignError(f"option {word!r} is not NAME=VALUE; write for example rate=10000")
        try:
            options[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            options[name.strip()] = value.strip()
    return options


def load_log(path: Path, format_name: str, options: Mapping[str, Any]) -> Recording:
    """Load a log; options that its format does not have are refused there."""
    return load(path, format=format_name, **options)


def inspect_files(
    paths: Sequence[Path],
    *,
    format_name: str = "auto",
    options: Mapping[str, Any] | None = None,
    plot: Path | None = None,
    as_json: bool = False,
) -> None:
    """Print what logs hold, as tables or JSON, and draw them.

    A log that is refused does not hide the others: its refusal stands in its place, and the last word.

    Parameters
    ----------
    paths : sequence of Path
        Logs.
    format_name : str
        Of all of them; ``"auto"`` judges by content.
    options : mapping, optional
        Loader options for all of them.
    plot : Path, optional
        Figure to write; of several logs, one under the other, without those that are refused.
    as_json : bool
        Print JSON and nothing else; of a log that is refused an object with the keys ``path`` and ``error``.

    Raises
    ------
    SysidError
        When a log is refused, behind what the others hold.
    """
    recordings: list[Recording] = []
    found: list[LogReport | tuple[Path, SysidError]] = []
    for path in paths:
        try:
            recording = load_log(path, format_name, options or {})
            found.append(inspect_recording(recording))
            recordings.append(recording)
        except SysidError as error:
            if len(paths) == 1:
                raise
            found.append((path, error))
    reports = [one for one in found if isinstance(one, LogReport)]
    refusals = [one for one in found if not isinstance(one, LogReport)]
    if not recordings:
        plot = None
    if plot is not None:
        from sysid.report.drawing import save_figure
        from sysid.report.inspect_figures import figure_logs

        save_figure(figure_logs(recordings, reports), plot)
    if as_json:
        rows = [
            one.as_json() if isinstance(one, LogReport) else {"path": str(one[0]), "error": str(one[1])}
            for one in found
        ]
        print(json.dumps(rows, ensure_ascii=False, indent=2))
    else:
        console = Console(soft_wrap=True)
        for one in found:
            if isinstance(one, LogReport):
                print_report(console, one)
            else:
                console.print(Text(str(one[0]), style="bold"))
                console.print(Text(f"  refused: {one[1]}", style="bold red"))
        if plot is not None:
            console.print(Text(f"wrote {plot}"))
    if refusals:
        raise type(refusals[0][1])(_refused(refusals, len(paths)))


def _refused(refusals: Sequence[tuple[Path, SysidError]], total: int) -> str:
    if len(refusals) == 1:
        return f"{refusals[0][1]} (1 of {total} logs refused)"
    names = ", ".join(str(path) for path, _ in refusals)
    return f"{len(refusals)} of {total} logs refused: {names}; what is wrong with each stands in its place"


@dataclass(frozen=True)
class SecondFile:
    """A second log of the same run: its own format and options, and by which channel its clock is found."""

    path: Path
    format_name: str = "auto"
    options: Mapping[str, Any] = field(default_factory=dict)
    align_by: str = "speed"


def convert_file(
    path: Path,
    to: Path,
    *,
    format_name: str = "auto",
    options: Mapping[str, Any] | None = None,
    second: SecondFile | None = None,
    force: bool = False,
) -> str:
    """Write a log, joined with a second one where it is given, in our HDF5 layout; return a sentence.

    Raises
    ------
    LogError
        When the destination exists and `force` is False, or the logs cannot be read or aligned.
    """
    sources = (path,) if second is None else (path, second.path)
    if to.resolve() in {source.resolve() for source in sources}:
        raise LogError(f"{to} is the log itself, which is never replaced; choose a new name")
    if to.exists() and not force:
        raise LogError(f"{to} exists already; choose a new name or replace it with --force")
    recording = load_log(path, format_name, options or {})
    said = ""
    if second is not None:
        other = load_log(second.path, second.format_name, second.options)
        recording, offset = join_recordings(recording, other, second.align_by)
        said = f"; {offset.sentence()}"
    write_recording(recording, to)
    return f"wrote {to}: {len(recording.channels)} channels of {path.name}{said}"


def print_formats(as_json: bool = False) -> None:
    """Print the formats that are read, those of installed packages included, with the options of each."""
    if as_json:
        rows = [
            {"format": name, "reads": one.describes, "options": list(one.options)}
            for name, one in formats().items()
        ]
        print(json.dumps(rows, ensure_ascii=False, indent=2))
        return
    table = Table(box=None, pad_edge=True)
    for title in ("format", "reads", "options"):
        table.add_column(title, no_wrap=title == "format")
    for name, one in formats().items():
        table.add_row(*(Text(cell) for cell in (name, one.describes, ", ".join(one.options) or "none")))
    Console().print(table)


def _number(value: float, digits: int = 4) -> str:
    return "—" if not np.isfinite(value) else f"{value:.{digits}g}"


def _clock_words(one: ChannelReport) -> str:
    words = [f"{one.samples} samples", f"{_number(one.rate, 5)} Hz"]
    if one.jitter > 0.01:
        words.append(f"jitter {100 * one.jitter:.0f} %")
    if one.holes:
        words.append(f"holes {one.holes}, longest {_number(one.longest_hole, 3)} s")
    return ", ".join(words)


def _value_words(one: ChannelReport) -> str:
    words = []
    if one.blank > 0:
        longest = f", longest {one.longest_blank:.3g} s" if np.isfinite(one.longest_blank) else ""
        words.append(f"blank {100 * one.blank:.3g} %{longest}")
    if one.saturated > 0:
        words.append(f"at its limit {100 * one.saturated:.2g} %")
    return "; ".join(words)


def print_report(console: Console, report: LogReport) -> None:
    """Print what a log holds."""
    described = formats()[report.format].describes if report.format in formats() else report.format
    console.print(Text(report.path, style="bold"))
    console.print(
        Text(f"  {described}; kind {report.kind}" + (f"; {report.device}" if report.device else ""))
    )
    if np.isfinite(report.duration):
        console.print(Text(f"  {report.duration:.4g} s"))
    table = Table(box=None, pad_edge=True)
    table.add_column("channel", no_wrap=True)
    table.add_column("unit")
    for name in ("lowest", "highest"):
        table.add_column(name, justify="right")
    table.add_column("")
    points = report.kind == "static-map"
    clocks = {one.name: f"{one.samples} points" if points else _clock_words(one) for one in report.channels}
    common = len(set(clocks.values())) == 1
    if common and report.channels:
        title = "rows" if points else "clock of all channels"
        console.print(Text(f"  {title}: {clocks[report.channels[0].name]}"))
    for one in report.channels[:_MOST_ROWS]:
        words = [word for word in ("" if common else clocks[one.name], _value_words(one)) if word]
        cells = [one.name, one.unit, _number(one.lowest), _number(one.highest), "; ".join(words)]
        table.add_row(*(Text(cell) for cell in cells))
    print_table(table, console)
    if len(report.channels) > _MOST_ROWS:
        console.print(Text(f"  and {len(report.channels) - _MOST_ROWS} channels more (--json lists them)"))
    for line in (*_drop_lines(report.drop), *_bench_lines(report.bench)):
        console.print(Text(f"  {line}"))
    for sentence in report.suspicions:
        console.print(Text(f"  suspicious: {sentence}", style="bold yellow"))
    for note in report.notes:
        if note in report.suspicions:
            continue
        console.print(Text(f"  note: {note}"))


def _drop_lines(drop: DropReport | None) -> list[str]:
    if drop is None:
        return []
    begin = "in motion from the start of its flight"
    if drop.release is not None:
        begin = f"released at {drop.release:.4f} ± {drop.release_error:.4f} s"
    lines = [
        f"drop of {drop.body}: {begin}, touchdown near {drop.touchdown:.3f} ± {drop.touchdown_error:.3f} s "
        f"at {drop.impact_speed:.2f} ± {drop.impact_speed_error:.2f} m/s after "
        f"{1e3 * drop.fall_height:.0f} mm; falls with {drop.gravity:.2f} m/s²",
        f'suggested: up = "{drop.up}"' + (f', down_slope = "{drop.down_slope}"' if drop.down_slope else ""),
    ]
    if drop.down_slope_doubt:
        lines[-1] += f" (down_slope is doubtful: {drop.down_slope_doubt})"
    if drop.slope is not None:
        lines.append(f"suggested: slope = {np.degrees(drop.slope):.1f} deg ({drop.slope_source})")
    return lines


def _bench_lines(bench: BenchReport | None) -> list[str]:
    if bench is None:
        return []
    lines = []
    if np.isfinite(bench.top_speed):
        lines.append(
            f"top speed {_number(bench.top_speed)} rad/s ({_number(bench.top_speed * 30 / np.pi)} rpm)"
        )
    if bench.commands:
        lines.append(
            f"{bench.commands} command levels from {_number(bench.lowest_command)} to "
            f"{_number(bench.highest_command)}; logger stalls: {bench.stalls}, of which "
            f"{bench.stalls_at_commands} hide when a command was given"
        )
    if np.isfinite(bench.rest_thrust) or np.isfinite(bench.rest_torque):
        lines.append(
            f"before anything turns: thrust {_number(bench.rest_thrust, 3)} N, torque "
            f"{_number(bench.rest_torque, 3)} N·m"
        )
    return lines
