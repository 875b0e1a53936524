"""What is damaged ends in what the file still says, or in one sentence; never in a traceback or a hang.

Logs, campaigns, stored files and calls of Python are opened by a process of its own under limits (`worker`),
which compares the content with the one before the damage. Damages that nothing tells are listed with why
nothing could (`SILENT`, `SILENT_FILES`).
"""

import shutil
import struct
import zlib
from operator import ne
from pathlib import Path

import numpy as np
import pytest

import sysid
from fakes.bowl import Bowl
from fakes.lag_kind import write_lag
from fakes.log_binary import BINARY, binary_log, cell_hdf5
from fakes.log_binary import DAMAGES as BINARY_DAMAGES
from fakes.log_samples import DAMAGES, DOCUMENT_DAMAGES, LOGS, Log, gigantic_field
from fakes.opened import ARGUMENTS, GEAR, MOTOR, STUDY, VALUES
from fakes.places import ROOT, SAMPLES
from fakes.slow_fit import IDENTITY, SETTINGS
from fakes.worker import BAD, Worker
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.search import Hooks, run_many
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions

QUICK, MANY = 22, 300
# Many damages of a log that a child process reads: each starts one, half a second.
MANY_FOREIGN = 60
# Cases that once ended in a traceback, a crash, a hang, too much memory, or in no short sentence.
FAILED = {
    "c3d": (11,), "mat-plain": (2132, 2179, 2683, 3768), "mat-7.3": (1595, 1824),
    "ros-mcap": (5,), "ros-sqlite": (0, 61), "sysid-hdf5": (1074,), "tdms": (12, 2032, 2222, 2508),
}  # fmt: skip
# Why nothing in the file could tell: by the family of formats, and what differs (`worker.difference`).
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


# --- campaigns, stored files, calls -------------------------------------------------------------------------

_STATED = "only its author knows what a campaign states; kinds, units and ranges are checked"
_DEFAULT = "a key that has a default, a comment or a whole trial is gone; what is needed is asked for"
_EDITABLE = "a file of sets is its owner's to edit; units and values are judged by the model's table"
_OLD = "the first version states no digest of its texts"
_TEXTS = "HDF5 has no checksum over names, attributes and texts; arrays have one"
# Why nothing could tell, by what is damaged and what differs: a number or text, or which of them there are.
SILENT_FILES = {
    "campaign": {"values": _STATED, "keys": _DEFAULT},
    "fit": {},
    "old fit": {"values": _OLD, "keys": _OLD},
    "sets.json": {"values": _EDITABLE, "keys": _EDITABLE},
    "sets.csv": {"values": _EDITABLE, "keys": _EDITABLE},
    "sets.h5": {"values": _TEXTS, "keys": _TEXTS},
    "sets.mat": {"values": "MAT files have a checksum over packed arrays alone"},
    "map.h5": {"values": _TEXTS, "keys": _TEXTS},
    "study.h5": {"values": _TEXTS, "keys": _TEXTS},
    "search.checkpoint": {},
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder of campaigns, a fit with intervals, an old fit, a checkpoint, sets, a map, a study."""
    folder = tmp_path_factory.mktemp("files")
    write_lag(folder, "runs = 1\npopulation = 8\nmax_generations = 2\n")
    for name in ("gear-lf", "gear-hf", "motor"):
        shutil.copy(SAMPLES / name / "campaign.toml", folder / f"{name}.toml")
    fit_campaign(folder / "lag.toml", FitOptions(out=folder / "fit", quiet=True, check=False))
    shutil.copytree(ROOT / "tests/data/old-fits/0.1.0", folder / "old")
    flag = Bowl()
    store = Checkpoint(folder / "search", IDENTITY)
    run_many(flag, SETTINGS, checkpoint=store, hooks=Hooks(should_stop=lambda: flag.calls > 40))
    store.close()
    sets = sysid.load_parameter_sets(MOTOR)
    for suffix in ("json", "csv", "h5", "mat"):
        sets.save(folder / f"sets.{suffix}")
    sysid.landing_map([GEAR], sets, check=False, **STUDY).save(folder / "map.h5")
    sysid.design_study(GEAR, sets, "k_h=1:2:2", **STUDY).save(folder / "study.h5")
    return folder


CAMPAIGNS = ("gear-lf", "gear-hf", "motor", "lag")
# What is opened and how, by what is damaged.
FILES = {f"{name}.toml": (f"{name}.toml", "campaign") for name in CAMPAIGNS}
FILES |= {f"fit/{name}": ("fit", "fit") for name in ("fit.h5", "fit.json", "trust.json", "trust.h5")}
FILES |= {f"old/{name}": ("old", "fit") for name in ("fit.h5", "fit.json", "trust.json")}
FILES |= {f"sets.{suffix}": (f"sets.{suffix}", "sets") for suffix in ("json", "csv", "h5", "mat")}
FILES |= {"map.h5": ("map.h5", "maps"), "study.h5": ("study.h5", "study")}
FILES |= {
    f"search.checkpoint/{name}": ("search.checkpoint", "checkpoint")
    for name in ("identity.json", "run-1-stage-1.npz", "run-1-stage-2.npz", "run-1-best.npz")
}
_DELIMITERS = {".toml": " = ", ".json": ": ", ".csv": ","}


def bench_files(worker, files, name, seeds):
    """Open what holds a damaged file; assert as `bench` does."""
    opened, kind = FILES[name]
    whole = files / opened
    target, suffix = files / name, Path(name).suffix
    if kind == "campaign":
        # Beside the whole one, as its logs are.
        target = path = files / f"damaged-{name}"
    else:
        path = files / "damaged" / opened
        shutil.rmtree(files / "damaged", ignore_errors=True)
        path.parent.mkdir()
        (shutil.copytree if whole.is_dir() else shutil.copy)(whole, path)
        target = files / "damaged" / name
    silent = {"campaign": "campaign", "checkpoint": "search.checkpoint"}.get(kind, opened)
    reasons = SILENT_FILES["old fit" if silent == "old" else silent]
    data, failed = (files / name).read_bytes(), []
    damages = DOCUMENT_DAMAGES if suffix in _DELIMITERS else BINARY_DAMAGES
    for seed in seeds:
        random = np.random.default_rng([zlib.crc32(name.encode()), seed])
        damage = damages[seed % len(damages)] if seed % 50 != 49 else gigantic_field
        form = Log(data, _DELIMITERS.get(suffix, ","), None, 0)
        target.write_bytes(damage(data if damages is BINARY_DAMAGES and seed % 50 != 49 else form, random))
        answer = worker.answer(kind, path, whole)
        if answer["outcome"] in BAD or (answer["outcome"] == "silent" and answer["what"] not in reasons):
            failed.append(f"{name}, seed {seed}, {damage.__name__}: {answer['outcome']}: {answer['what']}")
    assert not failed, "\n".join(failed)


MANY_CAMPAIGNS, MANY_FILES = 753, 35


@pytest.mark.parametrize("name", FILES)
def test_damaged_files(worker, files, name):
    many = 2 * len(DOCUMENT_DAMAGES) if name.endswith(".toml") else len(BINARY_DAMAGES)
    bench_files(worker, files, name, range(many))


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_many_damaged_files(worker, files, name):
    bench_files(worker, files, name, range(MANY_CAMPAIGNS if name.endswith(".toml") else MANY_FILES))


def bench_calls(worker, folder, numbers):
    """Call each function with hostile arguments; assert that each is taken or refused."""
    calls = [(*pair, number) for pair in ARGUMENTS for number in range(len(VALUES))]
    failed = []
    for number in numbers(len(calls)):
        answer = worker.answer("call", folder, folder, call=calls[number])
        if answer["outcome"] in BAD:
            name, argument, value = calls[number]
            failed.append(f"{name}({argument}={VALUES[value]!r:.20}): {answer['outcome']}: {answer['what']}")
    assert not failed, "\n".join(failed)


def test_hostile_arguments(worker, files):
    """A number that has no factor with the number of values takes each of them with each call in turn."""
    bench_calls(worker, files, lambda count: range(0, count, 5))


@pytest.mark.slow
def test_many_hostile_arguments(worker, files):
    assert len(ARGUMENTS) * len(VALUES) >= 288
    bench_calls(worker, files, range)


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
