"""Damaged logs end in a recording of what the file says, or in one sentence; never in a traceback or a hang.

Each damaged log is loaded by a process of its own under limits (`log_worker`), which compares it with the log
before the damage.
"""

import struct
import zlib
from operator import ne

import numpy as np
import pytest

from fakes.log_binary import BINARY, binary_log, cell_hdf5
from fakes.log_binary import DAMAGES as BINARY_DAMAGES
from fakes.log_samples import DAMAGES, LOGS, gigantic_field
from fakes.log_worker import BAD, Worker

QUICK, MANY = 22, 300
# Many damages of a log that a child process reads: each starts one, half a second.
MANY_FOREIGN = 60
# Cases that once ended in a traceback, a crash, a hang, too much memory, or in no short sentence.
FAILED = {
    "c3d": (11,), "mat-plain": (2132, 2179, 2683, 3768), "mat-7.3": (1595, 1824),
    "ros-mcap": (5,), "ros-sqlite": (0, 61), "sysid-hdf5": (1074,), "tdms": (12, 2032, 2222, 2508),
}  # fmt: skip
# Why nothing in the file could tell: by the family of formats, and what differs (`log_worker.difference`).
_HEADER_SAYS = "the header, which the damage may have reached, says so"
# Damages that reach the header. After any other a sample that differs without a note is a fault.
_HEADER_DAMAGES = ("flip", "splash", "drop_column", "swapped_names", "other_unit", "gigantic_field",
                   "exchanged_header_rows", "other_digit", "many_digits", "nesting")  # fmt: skip
_WHOLE_LINES = "whole lines are gone from a log that counts none; `inspect` shows the hole that they leave"
# Logs whose rows have no times: the clock counts the rows that are there.
_WITHOUT_TIMES = {"ati-text": {"values": "a row that is gone or doubled moves all rows after it"}}
_NO_SUM = "the format has no checksum over its names, units, rates and counts"
SILENT = {
    "text": {"values": _HEADER_SAYS, "clock": _HEADER_SAYS, "channels": _HEADER_SAYS, "rows": _WHOLE_LINES},
    "hdf5": dict.fromkeys(("values", "clock", "channels", "unit", "rows"), _NO_SUM),
    "mat": dict.fromkeys(("values", "clock", "channels", "unit"), _NO_SUM),
    "tdms": dict.fromkeys(("values", "clock", "channels", "unit", "rows"), _NO_SUM),
    "c3d": dict.fromkeys(("values", "clock", "channels", "unit", "rows"), _NO_SUM),
    "ros": dict.fromkeys(("channels", "rows", "values", "clock"), _NO_SUM),
}  # fmt: skip
FAMILY = {
    "load-cell-hdf5": "hdf5", "sysid-hdf5": "hdf5", "mat-7.3": "hdf5", "mat": "mat", "mat-plain": "mat",
    "tdms": "tdms", "c3d": "c3d", "ros-bag": "ros", "ros-mcap": "ros", "ros-sqlite": "ros",
}  # fmt: skip


@pytest.fixture(autouse=True)
def no_other_packages(monkeypatch):
    """Looking through all installed packages for formats takes longer than reading these logs."""
    monkeypatch.setattr("sysid.loaders.registry.entry_points", lambda group: ())


@pytest.fixture(scope="module")
def worker():
    with Worker() as process:
        yield process


def case(name, seed):
    """Return (format, whole log, options, damage, damaged log, how many bytes or lines differ)."""
    random = np.random.default_rng([zlib.crc32(name.encode()), seed])
    if name in LOGS:
        log = LOGS[name]
        form, whole, options = name, log.data, dict(log.options)
        damage = DAMAGES[seed % len(DAMAGES)] if seed % 50 else gigantic_field
        data = damage(log, random)
        parts, others = whole.split(b"\n"), data.split(b"\n")
    else:
        form, whole, options = binary_log(name)
        damage = BINARY_DAMAGES[seed % len(BINARY_DAMAGES)]
        data = damage(whole, random)
        parts, others = whole, data
    same = len(parts) == len(others)
    return form, whole, options, damage.__name__, data, same and sum(map(ne, parts, others))


def bench(worker, tmp_path, name, seeds):
    """Load damaged logs; assert that none failed, and that a reason is listed for each that says nothing."""
    path, place = tmp_path / "log.csv", tmp_path / "whole"
    failed = []
    for seed in seeds:
        form, whole, options, damage, data, differ = case(name, seed)
        place.write_bytes(whole)
        path.write_bytes(data)
        answer = worker.outcome(path, place, form, options, differ)
        if answer["outcome"] in BAD:
            failed.append(f"{name}, seed {seed}, {damage}: {answer['outcome']}: {answer['what']}")
        reasons = SILENT[FAMILY.get(name, "text")]
        if name in LOGS and damage not in _HEADER_DAMAGES:
            reasons = {"rows": _WHOLE_LINES} | _WITHOUT_TIMES.get(name, {})
        if answer["outcome"] == "silent" and answer["what"] not in reasons:
            failed.append(f"{name}, seed {seed}, {damage}: {answer['what']} differ and no reason is listed")
    assert not failed, "\n".join(failed)


@pytest.mark.parametrize("name", [*LOGS, "load-cell-hdf5", "sysid-hdf5"])
def test_damaged_logs(worker, tmp_path, name):
    bench(worker, tmp_path, name, [*range(QUICK), *FAILED.get(name, ())])


@pytest.mark.parametrize("name", ["mat-plain", "tdms", "c3d", "ros-mcap"])
def test_damaged_foreign_logs(worker, tmp_path, name):
    """One of each damage: every log starts a child process, half a second each."""
    bench(worker, tmp_path, name, range(len(BINARY_DAMAGES)))


def test_a_log_that_crashes_its_library_is_refused(worker, tmp_path):
    """The parser of scipy reads beyond its memory."""
    bench(worker, tmp_path, "mat-plain", [2683])


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LOGS, *BINARY])
def test_many_damaged_logs(worker, tmp_path, name):
    many = QUICK + (MANY if FAMILY.get(name, "text") in ("text", "hdf5") else MANY_FOREIGN)
    bench(worker, tmp_path, name, [*range(many), *FAILED.get(name, ())])


@pytest.mark.parametrize(
    ("object_number", "length"),
    [(4, 0), (4, 8), (4, 20), (0, 0), (2, 0), (2, 2**20), (4, 2**50), (1, 2**64 - 1)],
)
def test_damaged_list_of_texts_in_hdf5(worker, tmp_path, object_number, length):
    """A free space of no length keeps the HDF5 library at one place for ever (seen: no end after 14 s)."""
    data = bytearray(cell_hdf5())
    place = data.find(b"GCOL") + 16
    for _ in range(object_number):
        place += 16 + (struct.unpack_from("<Q", data, place + 8)[0] + 7) // 8 * 8
    struct.pack_into("<Q", data, place + 8, length)
    path = tmp_path / "log.h5"
    path.write_bytes(bytes(data))
    for form in ("load-cell-hdf5", "auto"):
        assert worker.outcome(path, path, form, {}, 1)["outcome"] == "refused"


@pytest.mark.parametrize("filling", [" ", "(", "p ", "_m"])
@pytest.mark.parametrize("format_name", LOGS)
def test_a_name_of_a_hundred_kilobytes_is_no_matter_of_minutes(worker, tmp_path, format_name, filling):
    """Patterns that look for units and axes in a name must not try every way to part it."""
    log = LOGS[format_name]
    lines = log.data.decode("utf-8").split("\n")
    at = 0 if log.names is None else log.names
    lines[at] = lines[at].replace(log.delimiter, filling * 100_000 + "x" + log.delimiter, 1)
    data = "\n".join(lines).encode("utf-8")
    path, whole = tmp_path / "log.csv", tmp_path / "whole"
    path.write_bytes(data)
    whole.write_bytes(log.data)
    assert worker.outcome(path, whole, format_name, dict(log.options), 1)["outcome"] not in BAD
