"""What is read: the commands `formats`, `inspect` (a log in words and figures) and `convert`."""

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from sysid.errors import CampaignError, LogError, SegmentError, SysidError, shell
from sysid.journal import Finding, folded, spoken
from sysid.loaders import formats, load
from sysid.loaders.alignment import join_recordings
from sysid.loaders.guess import Missing, missing
from sysid.loaders.readers.sysid_hdf5 import write_recording
from sysid.recording import Recording
from sysid.report.fold import console_of_lines, print_result, print_table
from sysid.report.table import NONE, listed, number, numbers, table, words
from sysid.storage import check_file
from sysid.trials.look import BenchReport, DropReport, LogReport, inspect_recording

_MOST_ROWS = 40
# Largest number of logs of which each is shown with its channels.
_FEW = 2
_HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf", ".he5")
Draw = Callable[[Sequence[Recording], Sequence[LogReport]], Path]


def print_formats(as_json: bool = False) -> None:
    """Print the formats that are read, with the options of each; installed packages may add formats."""
    kinds = formats().items()
    rows = [{"format": name, "reads": kind.describes, "options": list(kind.options)} for name, kind in kinds]
    if not print_result(rows, as_json):
        cells = [(name, kind.describes, ", ".join(kind.options) or "none") for name, kind in kinds]
        print_table(listed("", cells, ("format", "reads", "options"), texts=3))
        meanings = {name: text for _, kind in kinds for name, text in kind.help.items()}
        title = "Options, given by --option NAME=VALUE or as keys of a campaign"
        print_table(listed(title, meanings.items(), ("option", "meaning"), texts=2))


def parse_options(given: Sequence[str]) -> dict[str, object]:
    """Return loader options from ``name=value`` words; values are TOML, bare words are text.

    Raises `CampaignError` when a word has no ``=``.
    """
    options: dict[str, object] = {}
    for word in given:
        name, equals, value = word.partition("=")
        if not equals or not name.strip():
            raise CampaignError(f"option {word!r} is not NAME=VALUE; write for example rate=10000")
        try:
            options[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except (ValueError, RecursionError):
            options[name.strip()] = value.strip()
    return options


def inspect_files(
    paths: Sequence[Path],
    *,
    format_name: str = "auto",
    options: Mapping[str, object] | None = None,
    draw: Draw | None = None,
    details: bool = False,
    as_json: bool = False,
) -> None:
    """Print the content of logs, as tables or JSON, and draw them; of three and more a row each.

    A refused log does not hide the others. Its refusal takes its place, in JSON as an object with the
    keys ``path`` and ``error``, and is raised in the end. `draw` gets the logs that are not refused and
    returns the file.
    """
    recordings: list[Recording] = []
    results: list[tuple[Path, LogReport | SysidError]] = []
    given = dict(options or {})
    for path in paths:
        try:
            for recording in _segments(path, format_name, given):
                results.append((path, inspect_recording(recording)))
                recordings.append(recording)
        except SysidError as error:
            results.append((path, error))
    reports = [result for _, result in results if isinstance(result, LogReport)]
    figure = draw(recordings, reports) if draw is not None and recordings else None
    if as_json:
        rows = [
            result.as_json() if isinstance(result, LogReport) else {"path": str(path), "error": str(result)}
            for path, result in results
        ]
        if len(rows) > 1 or reports:
            print(json.dumps(rows, ensure_ascii=False, indent=2))
    else:
        console = console_of_lines()
        short = len(results) > _FEW and not details
        if short:
            _print_rows(console, reports)
        for path, result in results:
            channels: list[str] | None = None
            if isinstance(result, LogReport):
                if short:
                    continue
                print_log(console, result)
                if all(note.code != "columns-not-read" for note in result.notes):
                    continue
                channels = [channel.name for channel in result.channels]
            elif len(paths) > 1:
                console.print(Text(str(path), style="bold"))
                console.print(Text(f"  refused: {result}", style="bold red"))
            lacking = missing(path, format_name, given, channels)
            if lacking is not None:
                _print_missing(console, path, format_name, given, lacking, isinstance(result, SysidError))
        if figure is not None:
            console.print(Text(f"wrote {figure}"))
    refusals = [(str(path), result) for path, result in results if isinstance(result, SysidError)]
    if refusals and len(paths) == 1:
        raise refusals[0][1]
    if refusals:
        sentence = f"{refusals[0][1]} (1 of {len(paths)} logs refused)"
        if len(refusals) > 1:
            names = ", ".join(path for path, _ in refusals)
            sentence = f"{len(refusals)} of {len(paths)} logs refused: {names}; each says why in its place"
        raise type(refusals[0][1])(sentence)


def _print_rows(console: Console, reports: Sequence[LogReport]) -> None:
    """Print a row for each log, and what is common to them or looks wrong once."""
    drops, benches = any(report.drop for report in reports), any(report.bench for report in reports)

    def of_drop(shown: Callable[[DropReport], str]) -> Callable[[LogReport], str]:
        return lambda report: shown(report.drop) if report.drop else NONE

    def of_bench(shown: Callable[[BenchReport], float]) -> Callable[[LogReport], str]:
        return lambda report: number(shown(report.bench)) if report.bench else NONE

    degrees = of_drop(lambda drop: NONE if drop.slope is None else f"{np.degrees(drop.slope):.1f}")
    columns = (
        words("log", lambda report: Path(report.path).name),
        None if drops else numbers("lasts", lambda report: number(report.duration), "s"),
        numbers(
            "rate", lambda report: number(max((c.rate for c in report.channels), default=np.nan), 5), "Hz"
        ),
        numbers("touchdown", of_drop(lambda drop: f"{drop.touchdown:.3f}"), "s") if drops else None,
        numbers("impact", of_drop(_impact), "m/s") if drops else None,
        numbers("slope", degrees, "deg") if drops else None,
        numbers("top speed", of_bench(lambda bench: bench.top_speed), "rad/s") if benches else None,
        numbers("command levels", of_bench(lambda bench: bench.commands)) if benches else None,
    )
    print_table(table("", reports, columns), console)
    # A slope has a column.
    suggested = {line for report in reports if report.drop for line in _drop_lines(report.drop)[1:2]}
    for line in sorted(suggested):
        console.print(Text(line))
    for style, what in (("bold yellow", "suspicions"), ("", "notes")):
        findings = [
            replace(finding, trials=(Path(report.path).name,))
            for report in reports
            for finding in getattr(report, what)
            if what == "suspicions" or finding not in report.suspicions
        ]
        for finding in folded(findings):
            word = "suspicious" if style else "note"
            shown = Text(f"{word}: {spoken(finding, len(reports), 'logs')}", style=style)
            console.print(_with_code(shown, finding) if style else shown)
    console.print(Text("the channels of a log: sysid inspect LOG, or --details for all"))


def _with_code(line: Text, finding: Finding) -> Text:
    return line.append(f" [{finding.code}]", style="not bold dim default")


def _print_missing(
    console: Console, path: Path, format_name: str, given: Mapping[str, object], lacking: Missing,
    refused: bool,
) -> None:  # fmt: skip
    """Print the columns of a log, with guesses, and the command that gives all that it lacks."""
    columns = (
        words("column", attrgetter("name")),
        numbers("lowest", lambda column: number(column.lowest)),
        numbers("highest", lambda column: number(column.highest)),
        words("guess", lambda column: lacking.guess(column.name)),
    )
    print_table(table("", lacking.columns[:_MOST_ROWS], columns), console)
    if not lacking.options:
        rising = next((column.name for column in lacking.columns if column.step > 0), "TODO")
        named = toml_value({"time": rising} | dict.fromkeys(("speed", "thrust", "torque"), "TODO"))
        hint = f"if this is a log of a motor, name its columns: --format load-cell-csv -o 'columns = {named}'"
        console.print(Text(f"  {hint}"))
        return
    form = lacking.format or format_name
    stated = {**given, **lacking.options}
    command = ["sysid", "inspect", str(path), *(("--format", form) if form != "auto" else ())]
    command += [part for name, value in stated.items() for part in ("-o", f"{name} = {toml_value(value)}")]
    what = "what is missing" if refused else "columns that are not read, with the others"
    console.print(Text(f"  {what}, as guessed; check it, and replace each TODO:", style="bold"))
    console.print(Text(f"    {shell(*command)}"), soft_wrap=True)
    if lacking.fault:
        console.print(Text(f"  even then: {lacking.fault}"))


def toml_value(value: object) -> str:
    """Return the value of a loader option as TOML on one line."""
    if isinstance(value, Mapping):
        names = {key: key if re.fullmatch("[A-Za-z0-9_-]+", key) else json.dumps(key) for key in value}
        return "{" + ", ".join(f"{names[key]} = {toml_value(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _segments(path: Path, format_name: str, options: Mapping[str, object]) -> Iterator[Recording]:
    """Yield the recording of a log, or one for each segment where the log has several."""
    try:
        yield load(path, format=format_name, **options)
    except SegmentError as error:
        for number in range(1, error.count + 1):
            yield load(path, format=format_name, **(dict(options) | {"segment": number}))


@dataclass(frozen=True)
class SecondFile:
    """A second log of the same run: its format and options, and the channel that aligns its clock."""

    path: Path
    format_name: str = "auto"
    options: Mapping[str, object] = field(default_factory=dict)
    align_by: str = "speed"


def convert_file(
    path: Path,
    to: Path,
    *,
    format_name: str = "auto",
    options: Mapping[str, object] | None = None,
    second: SecondFile | None = None,
    force: bool = False,
) -> str:
    """Write a log, joined with a second one if given, in the HDF5 layout of sysid; return a sentence.

    Raises `LogError` when the destination exists and `force` is False, or the logs cannot be read or aligned.
    """
    sources = (path,) if second is None else (path, second.path)
    if to.resolve() in {source.resolve() for source in sources}:
        raise LogError(f"{to} is the log itself, which is never replaced; choose a new name")
    if to.suffix.lower() not in _HDF5_SUFFIXES:
        raise LogError(f"{to}: what is written is HDF5; name it {to.with_suffix('.h5').name}")
    check_file(to, force=force, error_type=LogError)
    recording = load(path, format=format_name, **(options or {}))
    alignment = ""
    if second is not None:
        other = load(second.path, format=second.format_name, **second.options)
        recording, offset = join_recordings(recording, other, second.align_by)
        alignment = f"; {offset.sentence()}"
    write_recording(recording, to)
    return f"wrote {to}: {len(recording.channels)} channels of {path.name}{alignment}"


def print_log(console: Console, report: LogReport) -> None:
    """Print the content of a log."""
    described = formats()[report.format].describes if report.format in formats() else report.format
    console.print(Text(report.path, style="bold"))
    device = f"; {report.device}" if report.device else ""
    console.print(Text(f"  {described}; kind {report.kind}{device}"))
    if np.isfinite(report.duration):
        console.print(Text(f"  {report.duration:.4g} s"))
    points = report.kind == "static-map"
    clocks: dict[str, str] = {}
    doubts: dict[str, str] = {}
    for channel in report.channels:
        clock = [f"{channel.samples} samples", f"{number(channel.rate, 5)} Hz"]
        if channel.jitter > 0.01:
            clock.append(f"jitter {100 * channel.jitter:.0f} %")
        if channel.holes:
            clock.append(f"holes {channel.holes}, longest {number(channel.longest_hole, 3)} s")
        clocks[channel.name] = f"{channel.samples} points" if points else ", ".join(clock)
        missing = []
        if channel.blank > 0:
            longest = f", longest {channel.longest_blank:.3g} s" if np.isfinite(channel.longest_blank) else ""
            missing.append(f"blank {100 * channel.blank:.3g} %{longest}")
        if channel.saturated > 0:
            missing.append(f"at its limit {100 * channel.saturated:.2g} %")
        doubts[channel.name] = "; ".join(missing)
    common = len(set(clocks.values())) == 1
    if common and report.channels:
        title = "rows" if points else "clock of all channels"
        console.print(Text(f"  {title}: {clocks[report.channels[0].name]}"))
    columns = (
        words("channel", attrgetter("name")),
        words("unit", attrgetter("unit")),
        numbers("lowest", lambda channel: number(channel.lowest)),
        numbers("highest", lambda channel: number(channel.highest)),
        None if common else words("clock", lambda channel: clocks[channel.name]),
        words("", lambda channel: doubts[channel.name]),
    )
    print_table(table("", report.channels[:_MOST_ROWS], columns), console)
    if len(report.channels) > _MOST_ROWS:
        console.print(Text(f"  and {len(report.channels) - _MOST_ROWS} channels more (--json lists them)"))
    lines = [] if report.drop is None else _drop_lines(report.drop)
    lines += [] if report.bench is None else _bench_lines(report.bench)
    for line in lines:
        console.print(Text(f"  {line}"))
    for finding in report.suspicions:
        console.print(_with_code(Text(f"  suspicious: {finding}", style="bold yellow"), finding))
    for note in report.notes:
        if note not in report.suspicions:
            console.print(Text(f"  note: {note}"))


def _impact(drop: DropReport) -> str:
    return f"{drop.impact_speed:.2f} ± {drop.impact_speed_error:.2f}"


def _drop_lines(drop: DropReport) -> list[str]:
    begin = "in motion from the start of its flight"
    if drop.release is not None:
        begin = f"released at {drop.release:.4f} ± {drop.release_error:.4f} s"
    lines = [
        f"drop of {drop.body}: {begin}, touchdown near {drop.touchdown:.3f} ± {drop.touchdown_error:.3f} s "
        f"at {_impact(drop)} m/s after "
        f"{1e3 * drop.fall_height:.0f} mm; falls with {drop.gravity:.2f} m/s²",
        f'suggested: up = "{drop.up}"' + (f', down_slope = "{drop.down_slope}"' if drop.down_slope else ""),
    ]
    if drop.down_slope_doubt:
        lines[-1] += f" (down_slope is doubtful: {drop.down_slope_doubt})"
    if drop.slope is not None:
        lines.append(f"suggested: slope = {np.degrees(drop.slope):.1f} deg ({drop.slope_source})")
    return lines


def _bench_lines(bench: BenchReport) -> list[str]:
    lines = []
    if np.isfinite(bench.top_speed):
        lines.append(
            f"top speed {number(bench.top_speed)} rad/s ({number(bench.top_speed * 30 / np.pi)} rpm)"
        )
    if bench.commands:
        hidden = f", {bench.stalls_at_commands} of them at a command, whose instant is lost"
        lines.append(
            f"{bench.commands} command levels from {number(bench.lowest_command)} to "
            f"{number(bench.highest_command)}; logger stalls: {bench.stalls}{hidden if bench.stalls else ''}"
        )
    if np.isfinite(bench.rest_thrust) or np.isfinite(bench.rest_torque):
        lines.append(
            f"before anything turns: thrust {number(bench.rest_thrust, 3)} N, torque "
            f"{number(bench.rest_torque, 3)} N·m"
        )
    return lines
