"""Readers of foreign binary formats in a child process: what a damaged file does there is one sentence.

Libraries of binary formats believe the lengths that a file states, some of them in C: a damaged file may
crash them, keep them for ever or make them take all memory. The child imports one reader and reads one file;
the parent limits its time and its memory; on Linux the kernel refuses memory that is taken faster than the
parent looks. The child answers with a line of JSON, then with the samples as plain numbers of eight bytes.
Its start costs some 0.5 s: Python, numpy and the library of the format.
"""

import faulthandler
import io
import json
import os
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from types import ModuleType

import numpy as np
import psutil

from sysid import errors
from sysid.errors import LogError, SysidError
from sysid.journal import Finding
from sysid.loaders.source import Source, shortened
from sysid.recording import Channel, Provenance, Recording
from sysid.types import FloatArray

# Processor time that a read may take [s], and further time for each byte of the file [s/byte].
_TIME, _TIME_PER_BYTE = 20.0, 2e-6
# Time by the clock, as a multiple of that: a busy machine refuses no file, a child that waits for ever ends.
_PATIENCE = 6.0
# Memory that a child may take [bytes], or this multiple of the file's size where that is more.
_MEMORY, _GAIN = 1 << 30, 20
# Length of the longest first line of an answer [bytes]: names, units and notes of thousands of channels.
_HEAD = 1 << 24
# The kernel's limit, as a multiple of that memory: it also counts memory that is reserved and never used.
_RESERVED = 2
# Interval at which the parent looks at the time and at the memory [s].
_LOOK = 0.01
_CHILD = """\
import json, sys
sys.path[:], *asked = json.loads(sys.stdin.buffer.readline())
from sysid.loaders.isolation import answer
answer(*asked)
"""
_REMEDY = "the file is damaged, so copy or export it again"


def library(path: str, module: str, package: str) -> ModuleType:
    """Return an optional library; LogError, which names the extra that brings it, without it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise LogError(
            f"{path}: reading this format needs {package} ({error}); install it with: "
            'python -m pip install "sysid[logs]"'
        ) from error


def read_here(module: str, source: Source, options: Mapping[str, object]) -> Recording:
    """Return what ``module.FORMAT.read(source, **options)`` returns; LogError where it fails in any way."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # the warnings are of damaged numbers
            recording: Recording = import_module(module).FORMAT.read(source, **options)
    except SysidError:
        raise
    except Exception as error:
        words = shortened(" ".join(str(error).split()), 200) or type(error).__name__
        raise LogError(f"{source.path}: damaged or cut ({words}); copy or export it again") from error
    return recording


def isolated(module: str, source: Source, options: Mapping[str, object]) -> Recording:
    """Return what `read_here` returns in a child process.

    A refusal there is the same refusal here. A child that crashes, does not end, takes too much memory or
    answers with something else is a LogError; no child outlives the call, nor this process.
    """
    path, size = source.path, os.path.getsize(source.path)
    seconds, memory = _TIME + _TIME_PER_BYTE * size, max(_MEMORY, _GAIN * size)
    patience = _PATIENCE * seconds
    try:
        child = subprocess.Popen(
            [sys.executable or "", "-P", "-c", _CHILD],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError as error:
        raise LogError(
            f"{path}: cannot start the process that reads this format ({error}); end other programs, or run "
            "sysid in an ordinary Python, then read the log again"
        ) from error
    with child:
        assert isinstance(child.stdin, io.BufferedWriter)
        assert isinstance(child.stdout, io.BufferedReader)
        overdrawn: list[str] = []
        watch = threading.Thread(
            target=_watch, args=(child, seconds, patience, memory, overdrawn), daemon=True
        )
        try:
            watch.start()
            places = [entry or os.getcwd() for entry in sys.path]
            asked = [places, module, path, options, patience, memory]
            child.stdin.write(json.dumps(asked, default=_plain).encode() + b"\n")
            child.stdin.flush()  # stays open: its end tells the child that this process is gone
            return _received(child.stdout)
        except SysidError:
            raise
        except Exception as error:  # whatever else was answered is no recording
            with suppress(subprocess.TimeoutExpired):
                child.wait(1.0)
            what = "its reader returned no recording"
            if child.returncode:
                what = f"its reader ended with code {child.returncode} before it had read the file"
            raise LogError(f"{path}: {''.join(overdrawn) or what}; {_REMEDY}") from error
        finally:
            child.kill()
            with suppress(OSError):  # the child ended before it was asked
                child.stdin.close()


def _plain(value: object) -> object:
    """Return an option that JSON does not know as a text, a list or a dict."""
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def _watch(
    child: subprocess.Popen[bytes], seconds: float, patience: float, memory: int, overdrawn: list[str]
) -> None:
    """Kill a child that takes too long or too much memory, and say so."""
    last = time.monotonic() + patience
    while child.poll() is None and not overdrawn:
        # The child has ended, or the system does not show what the child takes: the clock still counts.
        with suppress(psutil.Error):
            process = psutil.Process(child.pid)
            times = process.cpu_times()
            if times.user + times.system > seconds:
                overdrawn.append(
                    f"not read after {seconds:.3g} s of processor time, far longer than its size explains"
                )
            elif process.memory_info().rss > memory:
                overdrawn.append(_too_much(memory))
        if time.monotonic() > last:
            overdrawn.append(f"not read after {patience:.3g} s, far longer than its size explains")
        time.sleep(_LOOK)
    child.kill()


def _too_much(memory: int) -> str:
    return f"reading it takes more than {memory / 1e9:.3g} GB of memory, far more than its size explains"


def _received(stream: io.BufferedReader) -> Recording:
    """Return the recording that a child sent, or raise its refusal; another error for anything else."""
    document = json.loads(stream.readline(_HEAD))
    if "refusal" in document:
        name, sentence, cause = document["refusal"]
        refusal = getattr(errors, name)
        if not issubclass(refusal, SysidError):
            raise ValueError(f"{name} is no refusal")
        raise refusal(sentence) from (RuntimeError(cause) if cause else None)

    def array(shape: list[int]) -> FloatArray:
        numbers = np.empty(shape)
        if stream.readinto(numbers.data) != numbers.nbytes:
            raise EOFError("the samples are cut")
        numbers.setflags(write=False)
        return numbers

    clocks = [array([size]) for size in document["clocks"]]
    channels = {
        name: Channel(name, unit, clocks[clock], array(shape))
        for name, unit, clock, shape in document["channels"]
    }
    stated = document["provenance"]
    notes = tuple(
        Finding(**one | {"trials": tuple(one["trials"]), "parameters": tuple(one["parameters"])})
        for one in stated.pop("notes")
    )
    return Recording(document["kind"], channels, Provenance(**stated, notes=notes))


def answer(module: str, path: str, options: dict[str, object], patience: float, memory: int) -> None:
    """Read a file and write what came of it: all that a child does."""
    _limit_memory(memory)
    # Standard output is the answer's alone: what a library prints there goes nowhere.
    out, nowhere = os.fdopen(os.dup(1), "wb"), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    # A killed parent watches no more. A library in C may keep the thread from running, but not the alarm.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    faulthandler.dump_traceback_later(patience + 1.0, exit=True, file=nowhere)
    try:
        recording = read_here(module, Source(path), options)
        clocks = list({id(channel.time): channel.time for channel in recording.channels.values()}.values())
        places = {id(time): place for place, time in enumerate(clocks)}
        channels = list(recording.channels.values())
        document = {
            "kind": recording.kind,
            "clocks": [time.size for time in clocks],
            "channels": [(one.name, one.unit, places[id(one.time)], one.values.shape) for one in channels],
            "provenance": asdict(recording.provenance),
        }
        arrays = [*clocks, *(channel.values for channel in channels)]
    except SysidError as error:
        cause = error.__cause__
        said = "" if cause is None else "".join(traceback.format_exception(cause))
        sentence = str(error)
        if isinstance(cause, MemoryError):  # the kernel was faster than the parent
            sentence = f"{path}: {_too_much(memory)}; {_REMEDY}"
        document, arrays = {"refusal": [type(error).__name__, sentence, said]}, []
    out.write(json.dumps(document).encode() + b"\n")
    for numbers in arrays:
        out.write(numbers.data)
    out.flush()
    os._exit(0)


def _limit_memory(memory: int) -> None:
    """Let the kernel refuse far more memory than a read may take, beyond what the libraries have by now."""
    if sys.platform != "win32":
        import resource

        taken = psutil.Process().memory_info()
        most = getattr(taken, "data", taken.vms) + _RESERVED * memory
        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        if soft == resource.RLIM_INFINITY or most < soft:
            with suppress(ValueError, OSError):  # a system that knows no such limit
                resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


def _end_with_parent() -> None:
    """End this process when the parent has closed standard input, which it does also when it is killed."""
    os.read(0, 1)
    os._exit(1)
