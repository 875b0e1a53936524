"""A reader of a foreign format may crash, hang, take all memory or talk nonsense: each is one sentence."""

import io
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from fakes.log_binary import binary_log, cell_hdf5
from fakes.log_files import refuses, tdms
from fakes.places import SAMPLES
from sysid.errors import LogError
from sysid.loaders import formats, isolation, load
from sysid.loaders.source import Source

# A reader's module; each file has its own process write its number beside the file.
MODULE = """
import ctypes, os, time
from pathlib import Path
from sysid.loaders.registry import NO, LogFormat

def read(source):
    Path(source.path + ".pid").write_text(str(os.getpid()))
    {}

FORMAT = LogFormat("bad", "does harm", lambda source: NO, read, {{}}, foreign=True)
"""
HANGS = "while True: time.sleep(1.0)"
COMPUTES = "while True: pass"
HANGS_IN_C = "ctypes.PyDLL(None).pause()"
ANSWERS = "[os.write(fd, {!r}) for fd in range(3, 30) if os.path.exists(f'/proc/self/fd/{{fd}}')"
ANSWERS += " and 'pipe' in os.readlink(f'/proc/self/fd/{{fd}}')]; os._exit(0)"


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """Return a file's source whose reader does as the given line says."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(line):
        (tmp_path / "bad_reader.py").write_text(MODULE.format(line), encoding="utf-8")
        (tmp_path / "log.bin").write_bytes(b"log")
        return Source(tmp_path / "log.bin")

    return make


def ended(path, most=5.0):
    """Tell whether the process whose number is beside a file ends, in so many seconds at most."""
    number, last = int(Path(f"{path}.pid").read_text()), time.monotonic() + most
    while time.monotonic() < last:
        stat = Path(f"/proc/{number}/stat")
        try:
            if stat.read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.02)
    return False


linux = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes and limits in /proc")


@linux
@pytest.mark.parametrize(("line", "sentence"), [
    ("os.abort()", "its reader ended with code -6 before it had read the file"),
    ("os._exit(0)", "its reader returned no recording"),
    ("raise SystemExit(3)", "its reader ended with code 3 before"),
    (COMPUTES, "not read after 1.5 s of processor time, far longer than its size explains"),
    (HANGS_IN_C, "not read after 3 s, far longer than its size explains"),
    ("x = []\n    while True: x.append(b'x' * 10_000_000)", "takes more than 0.268 GB of memory, far more"),
    ("bytearray(b'x') * (1 << 40)", "takes more than 0.268 GB of memory, far more"),
    ("return None", "its reader ended with code 1 before it had read the file"),
    ("raise KeyError('units')", "damaged or cut"),
    (ANSWERS.format(b"\xff\x00garbage"), "its reader returned no recording"),
])  # fmt: skip
def test_what_a_reader_does_is_one_sentence(reader, monkeypatch, line, sentence):
    # A busy machine takes seconds to start the child, which only a reader that hangs may not have.
    monkeypatch.setattr(isolation, "_TIME", {COMPUTES: 1.5, HANGS_IN_C: 3.0}.get(line, 60.0))
    monkeypatch.setattr(isolation, "_PATIENCE", 1.0 if line == HANGS_IN_C else 6.0)
    monkeypatch.setattr(isolation, "_MEMORY", 1 << 28)
    source = reader(line)
    with pytest.raises(LogError, match=sentence) as caught:
        isolation.isolated("bad_reader", source, {})
    assert str(caught.value).startswith(f"{source.path}: ")
    assert "\n" not in str(caught.value)
    assert ended(source.path)


def test_a_child_that_ends_before_it_is_asked_is_one_sentence(reader, monkeypatch):
    monkeypatch.setattr(isolation, "_CHILD", "raise SystemExit(7)")
    source = reader("pass")
    # More than a pipe takes, so that the parent is still writing when the child has ended.
    with pytest.raises(LogError, match="its reader ended with code 7 before it had read the file"):
        isolation.isolated("bad_reader", source, {"names": "x" * 1_000_000})


def test_a_child_that_cannot_start_is_one_sentence(reader, monkeypatch):
    monkeypatch.setattr(sys, "executable", "")
    source = reader("pass")
    with pytest.raises(LogError, match=r"cannot start the process that reads this format .*; end other"):
        isolation.isolated("bad_reader", source, {})


RETURNS = """from sysid.journal import Finding
    from sysid.recording import Provenance, Recording
    note = Finding("odd", "words", "note", ("a", "b"), 2.5, ("mass",))
    return Recording("x", {}, Provenance("log.bin", "", "bad", notes=(note,)))"""


def test_a_finding_keeps_its_trials_size_and_parameters(reader):
    source = reader(RETURNS)
    wanted = isolation.read_here("bad_reader", source, {}).provenance
    assert isolation.isolated("bad_reader", source, {}).provenance == wanted


def test_a_reader_in_a_folder_whose_name_has_a_separator_is_found(reader, tmp_path, monkeypatch):
    source = reader(RETURNS)
    folder = tmp_path / (f"a{os.pathsep}b")
    folder.mkdir()
    (tmp_path / "bad_reader.py").rename(folder / "other_reader.py")
    monkeypatch.syspath_prepend(str(folder))
    assert isolation.isolated("other_reader", source, {}).kind == "x"


def test_a_child_that_the_system_does_not_show_is_read(reader, monkeypatch):
    def denied(number):
        raise psutil.AccessDenied(number)

    source = reader(RETURNS)
    monkeypatch.setattr(psutil, "Process", denied)
    assert isolation.isolated("bad_reader", source, {}).kind == "x"
    monkeypatch.setattr(isolation, "_TIME", 0.0)
    with pytest.raises(LogError, match=r"not read after .*e-05 s, far longer"):
        isolation.isolated("bad_reader", source, {})


@linux
def test_the_kernel_refuses_what_the_parent_does_not_see(reader, monkeypatch):
    monkeypatch.setattr(isolation, "_watch", lambda *asked: None)
    with pytest.raises(LogError, match=r"takes more than 1\.07 GB of memory, far more than its size"):
        isolation.isolated("bad_reader", reader("bytearray(1 << 32)"), {})


@pytest.mark.parametrize("answer", [
    b"", b"{}\n", b"[1, 2]\n", b'{"refusal": ["SystemExit", "x", ""]}\n',
    b'{"kind": "x", "clocks": [1000000000000], "channels": []}\n',
])  # fmt: skip
def test_an_answer_that_is_no_recording_is_not_believed(answer):
    with pytest.raises((ValueError, KeyError, TypeError, AttributeError, MemoryError, EOFError)):
        isolation._received(io.BytesIO(answer))


@linux
@pytest.mark.parametrize(
    ("end", "line"), [(signal.SIGINT, HANGS), (signal.SIGKILL, HANGS), (signal.SIGKILL, HANGS_IN_C)]
)
def test_no_child_outlives_an_interrupted_or_killed_parent(reader, tmp_path, end, line):
    source = reader(line)
    code = f"""
        from sysid.loaders import formats, isolation, load
        from sysid.loaders.source import Source
        isolation._PATIENCE, isolation._TIME = 1.0, {3.0 if end == signal.SIGKILL else 60.0}
        isolation.isolated("bad_reader", Source({source.path!r}), {{}})
    """
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], env=os.environ | {"PYTHONPATH": paths},
        stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    place, last = Path(f"{source.path}.pid"), time.monotonic() + 30.0
    while not (place.exists() and place.read_text()):
        assert time.monotonic() < last
        time.sleep(0.02)
    parent.send_signal(end)
    _, said = parent.communicate(timeout=10)
    assert ended(source.path)
    assert end == signal.SIGKILL or b"KeyboardInterrupt" in said


def test_an_option_that_is_no_finite_number_is_refused_as_in_this_process(tmp_path):
    path = tdms(tmp_path / "log.tdms", [("cell", "Fz", np.ones(50), {"unit_string": "N"})])
    for rate in (np.inf, np.nan):
        refuses(path, "is no sample rate; expected samples per second", rate=rate)


@pytest.mark.parametrize("name", ["mat", "mat-7.3", "tdms", "c3d", "ros-mcap"])
def test_a_child_returns_the_same_bits(tmp_path, name):
    form, data, options = binary_log(name)
    path = tmp_path / "log"
    path.write_bytes(data)
    module = formats()[form].read.__module__
    got = isolation.isolated(module, Source(path), options)
    wanted = isolation.read_here(module, Source(path), options)
    assert (got.kind, list(got.channels), got.provenance) == (
        wanted.kind,
        list(wanted.channels),
        wanted.provenance,
    )
    for channel, other in zip(got.channels.values(), wanted.channels.values(), strict=True):
        assert channel.unit == other.unit
        assert not channel.values.flags.writeable
        np.testing.assert_array_equal(channel.time.view(np.int64), other.time.view(np.int64))
        np.testing.assert_array_equal(channel.values.view(np.int64), other.values.view(np.int64))


def test_text_and_hdf5_start_no_child(tmp_path, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", None)
    path = tmp_path / "log.h5"
    path.write_bytes(cell_hdf5())
    load(path)
    load(SAMPLES / "motor" / "forward-1.csv")


def test_a_program_that_is_traced_goes_on_after_it_has_read_a_log():
    # A debugger, a profiler and a coverage tool trace; CPython 3.11 never left the next call.
    lines = [
        "import sys",
        "from sysid.loaders import load",
        "load(sys.argv[1])",
        "sys.settrace(lambda *event: None)",
        "(lambda: None)()",
        "print('went on')",
    ]
    log = SAMPLES / "motor" / "forward-1.csv"
    ended = subprocess.run(
        [sys.executable, "-c", "\n".join(lines), str(log)], capture_output=True, text=True, timeout=120
    )
    assert ended.stdout == "went on\n", ended.stderr
