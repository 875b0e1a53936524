"""Damaged logs end in a recording of what the file says, or in one sentence; never in a traceback or a hang.

The oracle of `log_oracle` reads each damaged file a second time. Faults planted in the loaders show that the
oracle can object.
"""

import _thread
import contextlib
import faulthandler
import io
import struct
import threading
import time as clock
import warnings
from importlib import import_module

import h5py
import numpy as np
import pytest

from fakes.log_oracle import assert_matches
from fakes.log_readers import READERS
from fakes.log_samples import DAMAGES, LOGS, gigantic_field
from sysid.errors import SysidError
from sysid.loaders import load

QUICK, MANY = 12, 5000
# Far above any load of these 40-row logs (some ms): only a hang reaches it.
HANG = 5.0
# This limit is by the clock, which runs on while a busy machine does other work.
STUCK = 300.0


@pytest.fixture(autouse=True)
def no_other_packages(monkeypatch):
    """Looking through all installed packages for formats takes longer than reading these logs."""
    monkeypatch.setattr("sysid.loaders.registry.entry_points", lambda group: ())


def cell_hdf5():
    stream = io.BytesIO()
    random = np.random.default_rng(5)
    with h5py.File(stream, "w") as file:
        file.attrs["rate"] = 10000.0
        for name, unit in {"Command": "us", "Speed": "rad/s", "Fz": "N", "Mz": "N·m"}.items():
            data = file.create_dataset(name, data=random.normal(size=200), compression="gzip", chunks=(50,))
            data.attrs["unit"] = unit
    return stream.getvalue()


@contextlib.contextmanager
def watchdog():
    """Interrupt what takes more than five seconds of processor time, and fail it.

    A loop in compiled code, which nothing in the process can interrupt, ends the process with a traceback.
    """
    done = threading.Event()
    began = clock.process_time()

    def watch():
        while not done.wait(HANG):
            if clock.process_time() - began > HANG:
                _thread.interrupt_main()
                return

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    faulthandler.dump_traceback_later(STUCK, exit=True)
    try:
        yield
    except KeyboardInterrupt:
        raise AssertionError(f"no end after {HANG:g} s") from None
    finally:
        faulthandler.cancel_dump_traceback_later()
        done.set()
        thread.join()


def outcome(path, format_name, options=None):
    """Load; return the recording or None, having checked the sentence."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return load(path, format=format_name, **(options or {}))
        except SysidError as error:
            text = str(error)
            if not text.startswith(str(path)) or "\n" in text or len(text) > 1500:
                raise AssertionError(f"not one short sentence that begins with the file: {text!r}") from error
            return None


def judge(data, recording):
    """Assert that a recording is what the bytes of its log say."""
    try:
        tables = READERS[recording.provenance.format](data, recording)
    except Exception as error:
        raise AssertionError(f"loaded although nothing is told: {error!r}") from error
    assert_matches(recording, tables)


def check(tmp_path, format_name, damage, count, seed):
    """Damage a log `count` times; return how many were loaded."""
    random = np.random.default_rng(seed)
    log = LOGS[format_name]
    loaded = 0
    path = tmp_path / "log.csv"
    with watchdog():
        for case in range(count):
            data = damage(log, random)
            path.write_bytes(data)
            asked = "auto" if case % 10 == 0 and not log.options else format_name
            try:
                recording = outcome(path, asked, log.options)
                if recording is not None:
                    loaded += 1
                    judge(data, recording)
            except Exception as error:
                raise AssertionError(f"{format_name}, {damage.__name__}, seed {seed}, case {case}") from error
    return loaded


@pytest.mark.parametrize("format_name", LOGS)
def test_whole_logs_are_what_the_oracle_reads(write, format_name):
    log = LOGS[format_name]
    path = write(log.data, "log.csv")
    for asked in (format_name, "auto"):
        if asked == "auto" and log.options:
            continue
        recording = load(path, format=asked, **log.options)
        assert all(len(channel.values) >= 30 for channel in recording.channels.values())
        judge(log.data, recording)


def shifted(values):
    """Every sample is that of the row before."""
    return np.roll(values, 1)


def scaled(values):
    """Off by one millionth: a factor of rounded digits."""
    return values * (1 + 1e-6)


def filled_forward(values):
    seen = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(values.size)))
    return values[seen]


def interpolated(values):
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(values.size), known, values[known]) if known.size else values


def smoothed(values):
    return np.where(np.isnan(values), np.nan, np.convolve(np.nan_to_num(values), [0.25, 0.5, 0.25], "same"))


def gapped(values):
    return np.where(np.arange(values.size) == 21, np.nan, values)


def left_out(numbers):
    """A row of the middle vanishes without a word."""
    numbers.keep(np.arange(numbers.lines.size) != 22)


def neighbours_swapped(numbers):
    """Two neighbouring columns change places."""
    last = sorted(numbers.columns)[-2:]
    numbers.columns |= {a: numbers.columns[b] for a, b in zip(last, reversed(last), strict=True)}


def row_made_up(numbers):
    """A row between two others is halfway between them."""
    between = {k: (v[21:22] + v[22:23]) / 2 for k, v in numbers.columns.items()}
    numbers.columns = {k: np.insert(v, 22, between[k]) for k, v in numbers.columns.items()}
    numbers.lines = np.insert(numbers.lines, 22, numbers.lines[21])


# The columns that are clocks, where the others are samples.
CLOCKS = {"rcbenchmark-csv": {0}, "load-cell-csv": {0}, "motive-csv": {0, 1}, "pose-table": {0}, "lvm": {0},
          "vicon-csv": {0, 1}, "qualisys-tsv": {0, 1}, "ros-csv": {0, 2}, "net-ft-csv": {1}}  # fmt: skip
SAMPLE_FAULTS = (shifted, scaled, filled_forward, interpolated, np.nan_to_num, smoothed, gapped)
ROW_FAULTS = (left_out, neighbours_swapped, row_made_up)
FAULTS = (*SAMPLE_FAULTS, *ROW_FAULTS)
# Frame numbers against times, and matrices that are no rotations.
SEEN_BY_THE_LOADER = {
    ("motive-csv", row_made_up), ("qualisys-tsv", row_made_up), ("qualisys-tsv", neighbours_swapped),
}  # fmt: skip


@pytest.mark.parametrize(
    ("format_name", "fault"),
    # A body all of whose cells are zero is a lost one to Qualisys: filling with zeros changes nothing there.
    [(name, f) for name in LOGS for f in FAULTS if (name, f) != ("qualisys-tsv", np.nan_to_num)],
)
def test_the_oracle_objects_to_a_planted_fault(write, monkeypatch, format_name, fault):
    log, module = LOGS[format_name], import_module(f"sysid.loaders.readers.{format_name.replace('-', '_')}")

    def faulty(*arguments, **options):
        numbers = read(*arguments, **options)
        if fault in ROW_FAULTS:
            fault(numbers)
        else:
            kept = CLOCKS.get(format_name, set())
            # Turns stay too: a wrong one has another length, which the loader itself refuses.
            kept = kept | {k for k, v in numbers.columns.items() if np.nanmax(np.abs(v)) <= 1}
            numbers.columns = {k: v if k in kept else fault(v) for k, v in numbers.columns.items()}
        return numbers

    # A log of one row per frame has no table to read: there the rows go through this class.
    name = "Numbers" if format_name == "motive-legacy" else "read_numbers"
    module = module if hasattr(module, name) else import_module("sysid.loaders.columns")
    read = getattr(module, name)
    monkeypatch.setattr(module, name, faulty)
    if format_name == "motive-legacy":
        monkeypatch.setitem(CLOCKS, format_name, {0})
    path = write(log.data, "log.csv")
    if (format_name, fault) in SEEN_BY_THE_LOADER:
        with pytest.raises(SysidError):
            load(path, format=format_name)
        return
    recording = load(path, format=format_name, **log.options)
    with pytest.raises(AssertionError):
        judge(log.data, recording)


@pytest.mark.parametrize("damage", [*DAMAGES, gigantic_field], ids=lambda damage: damage.__name__)
@pytest.mark.parametrize("format_name", LOGS)
def test_damaged_text(tmp_path, format_name, damage):
    check(tmp_path, format_name, damage, 3 if damage is gigantic_field else QUICK, 7)


@pytest.mark.slow
@pytest.mark.parametrize("format_name", LOGS)
def test_damaged_text_many(tmp_path, format_name):
    each = -(-MANY // len(DAMAGES))
    for damage in DAMAGES:
        for start in range(0, each, 50):
            check(tmp_path, format_name, damage, 50, 1000 + start)
    for seed in range(9, 19):
        check(tmp_path, format_name, gigantic_field, 2, seed)


def stored_bytes(original):
    """Where the compressed samples lie in the file."""
    places = []
    with h5py.File(io.BytesIO(original), "r") as file:
        for data in file.values():
            for chunk in range(data.id.get_num_chunks()):
                info = data.id.get_chunk_info(chunk)
                places += range(info.byte_offset, info.byte_offset + info.size)
    return np.array(places)


def hdf5_cases(tmp_path, count, seed):
    """Cut files, and files damaged where the samples lie.

    Damage to the HDF5 library's own structures has a test of its own: some of it makes the library loop for
    ever, which nothing in the same process can stop.
    """
    random = np.random.default_rng(seed)
    original = cell_hdf5()
    places = stored_bytes(original)
    path = tmp_path / "log.h5"
    path.write_bytes(original)
    whole = load(path)
    for case in range(count):
        data = bytearray(original)
        if case % 2:
            for at in random.choice(places, random.integers(1, 5)):
                data[at] ^= 1 << random.integers(0, 8)
        else:
            data = data[: random.integers(0, len(data))]
        path.write_bytes(data)
        recording = outcome(path, "auto" if case % 4 == 0 else "load-cell-hdf5")
        if recording is not None:
            # The check sum of the compression finds every damaged sample; what loads is what was written.
            for name, channel in recording.channels.items():
                np.testing.assert_array_equal(channel.values, whole[name].values)


@pytest.mark.parametrize(
    ("object_number", "length"),
    [(4, 0), (4, 8), (4, 20), (0, 0), (2, 0), (2, 2**20), (4, 2**50), (1, 2**64 - 1)],
)
def test_damaged_list_of_texts_in_hdf5(write, object_number, length):
    """A free space of no length keeps the HDF5 library at one place for ever (seen: no end after 14 s)."""
    data = bytearray(cell_hdf5())
    place = data.find(b"GCOL") + 16
    for _ in range(object_number):
        place += 16 + (struct.unpack_from("<Q", data, place + 8)[0] + 7) // 8 * 8
    struct.pack_into("<Q", data, place + 8, length)
    path = write(bytes(data), "log.h5")
    with watchdog():
        assert outcome(path, "load-cell-hdf5") is None
        assert outcome(path, "auto") is None


def test_damaged_hdf5(tmp_path):
    hdf5_cases(tmp_path, 2 * QUICK, 11)


@pytest.mark.slow
def test_damaged_hdf5_many(tmp_path):
    hdf5_cases(tmp_path, MANY, 12)


@pytest.mark.parametrize("filling", [" ", "(", "p ", "_m"])
@pytest.mark.parametrize("format_name", LOGS)
def test_a_name_of_a_hundred_kilobytes_is_no_matter_of_minutes(write, format_name, filling):
    """Patterns that look for units and axes in a name must not try every way to part it."""
    log = LOGS[format_name]
    lines = log.data.decode("utf-8").split("\n")
    at = 0 if log.names is None else log.names
    lines[at] = lines[at].replace(log.delimiter, filling * 100_000 + "x" + log.delimiter, 1)
    data = "\n".join(lines).encode("utf-8")
    path = write(data, "log.csv")
    with watchdog():
        recording = outcome(path, format_name, log.options)
    if recording is not None:
        judge(data, recording)
