"""The formats that sysid reads: one module each, one line here, or an entry point from outside.

Another package adds a format by declaring, in its pyproject.toml::

    [project.entry-points."sysid.loaders"]
    my-format = "my_package.my_format:FORMAT"

where ``FORMAT`` is a `LogFormat`.
"""

import ctypes
import difflib
import inspect
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TypeVar

import numpy as np

from sysid.errors import LogError, SysidError
from sysid.journal import Finding, notice
from sysid.loaders.columns import naming
from sysid.loaders.isolation import isolated
from sysid.loaders.options import DECLARED, Option
from sysid.loaders.source import Source, check_foreign, one_line
from sysid.recording import Recording
from sysid.units import parse_quantity

ENTRY_POINT_GROUP = "sysid.loaders"

NO, POSSIBLE, CERTAIN = 0, 1, 2
# Options of a family of formats, and what its readers return.
_Options = TypeVar("_Options")
_Raw = TypeVar("_Raw")


@dataclass(frozen=True)
class LogFormat:
    """One log format.

    `name` is what a user writes as ``format``, `describes` one line for lists. ``recognize(source)`` returns
    NO, POSSIBLE or CERTAIN from `Source.head` and raises nothing; ``read(source, **options)`` returns the
    recording. `takes` are the options of `sysid.loaders.options` that `read` takes, and the values among
    which this format chooses (empty: any); without it, the keyword-only arguments of `read`. A `foreign`
    format is read by a library that a damaged file may crash: in a child process, which imports the module of
    `read` and takes the format from its ``FORMAT``.
    """

    name: str
    describes: str
    recognize: Callable[[Source], int]
    read: Callable[..., Recording]
    takes: Mapping[str, tuple[str, ...]] | None = None
    foreign: bool = False

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options that `read` takes."""
        if self.takes is not None:
            return tuple(self.takes)
        parameters = inspect.signature(self.read).parameters.values()
        return tuple(p.name for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY)

    @property
    def help(self) -> dict[str, str]:
        """What each option means that sysid knows, with its choices."""
        known = {name: DECLARED[name] for name in self.options if name in DECLARED}
        return {
            name: option.help + (f" One of {', '.join(option.choices)}." if option.choices else "")
            for name, option in known.items()
        }


# Modules in `sysid.loaders.readers`, in the order of lists and messages.
_BUILT_IN = (
    "rcbenchmark_csv", "load_cell_csv", "esc32_csv", "bitcraze_csv", "load_cell_hdf5", "ati_text",
    "net_ft_csv", "tdms", "lvm", "mat", "motive_csv", "pose_table", "vicon_csv", "qualisys_tsv", "c3d",
    "ros_csv", "ros_bag", "sysid_hdf5",
)  # fmt: skip


def _built_in() -> dict[str, LogFormat]:
    entries = [import_module(f"sysid.loaders.readers.{module}").FORMAT for module in _BUILT_IN]
    return {entry.name: entry for entry in entries}


def formats() -> dict[str, LogFormat]:
    """Return every format by name: the built-in ones, then what installed packages bring."""
    known = _built_in()
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            entry = point.load()
        except Exception as error:  # another package's code must not stop the built-in formats
            notice("format-not-loaded", f"log format {point.name!r} cannot be loaded: {error}")
            continue
        if isinstance(entry, LogFormat) and entry.name not in known:
            known[entry.name] = entry
            continue
        reason = f"repeats {entry.name!r}" if isinstance(entry, LogFormat) else "is no LogFormat"
        notice("format-left-out", f"log format {point.name!r} {reason}; left out")
    return known


def family_format(
    options: Callable[..., _Options],
    record: Callable[[Source, str, Callable[[Source, _Options], _Raw], _Options], Recording],
    name: str,
    describes: str,
    recognize: Callable[[Source], int],
    parse: Callable[[Source, _Options], _Raw],
    takes: Mapping[str, tuple[str, ...]],
    foreign: bool = False,
) -> LogFormat:
    """Return a format of a family, which makes a recording of what ``parse(source, options)`` returns."""

    def read(source: Source, **given: object) -> Recording:
        return record(source, name, parse, options(**given))

    read.__module__ = parse.__module__
    return LogFormat(name, describes, recognize, read, takes, foreign)


def plug_in_options() -> set[str]:
    """Return the options of formats that other packages bring."""
    built_in = _built_in()
    return {option for name, known in formats().items() if name not in built_in for option in known.options}


def _hint(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), 1)
    return f'; did you mean "{near[0]}"?' if near else ""


def _detect(source: Source) -> LogFormat:
    # Formats that sysid has given up.
    if source.head.startswith(b"ULog\x01\x12\x35"):
        raise LogError(
            f"{source.path}: a PX4 ULog, which sysid does not read: no fit takes what a drone logs itself; "
            "give the log of the motion capture or of the thrust stand"
        )
    if any(line.strip().casefold().startswith("info,version,1.") for line in source.head_lines[:60]):
        raise LogError(
            f"{source.path}: an export of OptiTrack Motive 1.1 or Tracking Tools (one row per frame, 2012), "
            "which sysid does not read; open the take in Motive 2 or later and export it again as CSV"
        )
    known = formats()
    votes = {name: entry.recognize(source) for name, entry in known.items()}
    winners = [name for name, vote in votes.items() if vote == max(votes.values()) > NO]
    if not winners:
        check_foreign(source)
        raise LogError(
            f"{source.path}: not recognized as any log format by its content; if 'sysid formats' lists its "
            'format, name it with --format, or in a campaign with format = "..."'
        )
    if len(winners) > 1:
        fits = f"the content fits {' and '.join(winners)}"
        raise LogError(
            f"{source.path}: {fits}; choose one with --format {winners[0]}, or in a campaign with "
            f'format = "{winners[0]}"'
        )
    return known[winners[0]]


def detect(path: str | Path) -> str:
    """Return the name of a log's format, judged by its content and never by its suffix.

    A file that cannot be read, and one that fits no format or several, are a LogError.
    """
    return _detect(Source(path)).name


# Largest processor time of a load in this process: constant part [s] and part per byte of the file [s/byte];
# an undamaged file takes a thirtieth of that time.
_TIME, _TIME_PER_BYTE = 60.0, 2e-6
# Largest number that a log may hold, in SI: the square of a larger one may be none.
_LARGEST = 1e100


class _OverdueError(BaseException):
    """Raised inside a load that takes too long; a parser's ``except Exception`` does not catch it."""


@contextmanager
def _bounded_time(path: str) -> Iterator[None]:
    """Refuse a file whose load computes far longer than its size explains, in any thread and on any system.

    The processor time of the process counts, so that a busy machine or a laptop that sleeps refuses no file.
    A library in C is stopped when it returns to Python; `sysid.loaders.hdf5` refuses before what could keep
    the HDF5 library for ever.
    """
    size = Path(path).stat().st_size
    most = _TIME + _TIME_PER_BYTE * size
    thread, ended, lock = ctypes.c_ulong(threading.get_ident()), threading.Event(), threading.Lock()
    raise_there, last = ctypes.pythonapi.PyThreadState_SetAsyncExc, time.process_time() + most

    def watch() -> None:
        while not ended.wait(max(last - time.process_time(), 0.0)):
            with lock:
                if not ended.is_set() and time.process_time() >= last:
                    raise_there(thread, ctypes.py_object(_OverdueError))
                    return

    threading.Thread(target=watch, daemon=True).start()
    try:
        try:
            yield
        finally:
            with lock:
                ended.set()
            # An exception that is on its way arrives at this call. Taken back by a None it would leave its
            # flag in CPython for ever, and a program under a debugger or a profiler would not go on.
            (lambda: None)()
    except _OverdueError:
        raise LogError(
            f"{path}: not read after {most:.3g} s of processor time, far longer than {size / 1e6:.3g} MB "
            "explain; the file is damaged, so copy or export it again"
        ) from None


def load(path: str | Path, *, format: str = "auto", **options: object) -> Recording:
    """Read one log: channels in SI, each on its own clock [s], with provenance.

    Parameters
    ----------
    format : str
        Name of the format, or ``"auto"`` to judge by content.
    **options
        What the log itself does not state, see `sysid.loaders.options`; a format takes the options in
        `LogFormat.options`. A rate [Hz] or a tare [s] may be a text with its unit (``"10 kHz"``). None counts
        as not given.

    Raises
    ------
    LogError, UnitError
        One sentence with file, line and cause.
    """
    source = Source(path)
    if not isinstance(format, str):
        raise LogError(f"{source.path}: format = {format!r:.60} is no text; expected the name of a format")
    if format == "auto":
        chosen = _detect(source)
    else:
        known = _built_in()  # looking through all installed packages takes longer than most logs
        known = known if format in known else formats()
        if format not in known:
            hint = _hint(format, known)
            raise LogError(f"{source.path}: unknown format {format!r}; known are {', '.join(known)}{hint}")
        chosen = known[format]
    if chosen.read.__module__.startswith("sysid."):  # another package's format may be an archive
        check_foreign(source)
    given = {name: value for name, value in options.items() if value is not None}
    unknown = sorted(set(given) - set(chosen.options))
    if unknown:
        raise LogError(
            f'{source.path}: format {chosen.name} has no option "{unknown[0]}"; '
            f"it has {', '.join(chosen.options) or 'none'}{_hint(unknown[0], chosen.options)}"
        )
    _check_kinds(source.path, given)
    for name, value in given.items():
        option = DECLARED.get(name, Option(""))
        choices = () if chosen.takes is None else chosen.takes[name] or option.choices
        if choices and not (isinstance(value, str) and value in choices):
            expected = " or ".join(", ".join(f'"{word}"' for word in choices).rsplit(", ", 1))
            raise LogError(f"{source.path}: {name} = {value!r} is unknown; expected {expected}")
        if option.unit and isinstance(value, str):
            with naming(f"{source.path}: {name} = {value!r}"):
                given[name] = parse_quantity(value, option.unit)
    try:
        if chosen.foreign:
            return _measurable(isolated(chosen.read.__module__, source, given))
        # The warnings are of damaged numbers.
        with np.errstate(over="ignore", invalid="ignore"), _bounded_time(source.path):
            return _measurable(chosen.read(source, **given))
    except SysidError as error:
        error.args = (one_line(str(error)),)
        raise


def _measurable(recording: Recording) -> Recording:
    """Return a recording without numbers that nothing measures, which a damaged file has."""
    channels = dict(recording.channels)
    for name, channel in recording.channels.items():
        low, high = (
            float(ends.reduce(channel.values, axis=None, initial=0.0)) for ends in (np.fmin, np.fmax)
        )
        if max(-low, high) > _LARGEST:
            channels[name] = replace(
                channel, values=np.where(np.abs(channel.values) > _LARGEST, np.nan, channel.values)
            )
    changed = [name for name, channel in channels.items() if channel is not recording.channels[name]]
    if not changed:
        return recording
    sentence = f"numbers beyond {_LARGEST:g}, taken as missing: in {', '.join(changed)}"
    notes = (*recording.provenance.notes, Finding("absurd-numbers", one_line(sentence)))
    return Recording(recording.kind, channels, replace(recording.provenance, notes=notes))


def _check_kinds(path: str, given: Mapping[str, object]) -> None:
    """Refuse an option of another kind than any reader means by it: a text "no" would count as true."""
    if not isinstance(static := given.get("static", False), bool):
        raise LogError(f"{path}: static = {static!r} is neither true nor false; write static = true")
    if not isinstance(calibration := given.get("calibration", ""), str | Path):
        raise LogError(
            f'{path}: calibration = {calibration!r} is no path; expected for example calibration = "FT1.cal"'
        )
    bodies = given.get("bodies", {})
    for name, markers in bodies.items() if isinstance(bodies, Mapping) else ():
        if not isinstance(markers, str | list | tuple):
            raise LogError(
                f"{path}: bodies gives {name} as {markers!r}, which is no list of markers; expected for "
                f'example {{{name} = ["q1", "q2", "q3"]}}'
            )
