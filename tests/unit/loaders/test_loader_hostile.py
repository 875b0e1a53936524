"""Files that promise more than they have, reach outside or would take all memory are refused."""

import sqlite3
import struct
import time
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest

from fakes.log_files import c3d, hdf5, notes, quaternions_of, refuses, ros_recording, small_turns, tdms
from fakes.worker import Worker
from sysid.errors import LogError
from sysid.loaders import isolation, load, registry

ONES = np.ones(50)


def external_link(file, folder):
    with h5py.File(folder / "secret.h5", "w") as other:
        other["Fz"] = ONES
    file["Fz"] = h5py.ExternalLink("secret.h5", "/Fz")


def link_out_by_link(file, folder):
    external_link(file, folder)
    file["moved"] = file.get("Fz", getlink=True)
    del file["Fz"]
    file["Fz"] = h5py.SoftLink("/moved")


def soft_loop(file, folder):
    file["Fz"], file["again"] = h5py.SoftLink("/again"), h5py.SoftLink("/Fz")


def soft_to_itself(file, folder):
    file["Fz"] = h5py.SoftLink("Fz")


def soft_to_nothing(file, folder):
    file["Fz"] = h5py.SoftLink("/there/is/none")


def virtual(file, folder):
    with h5py.File(folder / "secret.h5", "w") as other:
        other["Fz"] = ONES
    layout = h5py.VirtualLayout(shape=(50,), dtype=float)
    layout[:] = h5py.VirtualSource(str(folder / "secret.h5"), "Fz", shape=(50,))
    file.create_virtual_dataset("Fz", layout)


def external_bytes(file, folder):
    (folder / "secret.bin").write_bytes(ONES.tobytes())
    file.create_dataset("Fz", (50,), float, external=[(str(folder / "secret.bin"), 0, 400)])


def objects(file, folder):
    file.create_dataset("Fz", data=["1.0"] * 50, dtype=h5py.string_dtype())


def references(file, folder):
    file["n"] = ONES
    file.create_dataset("Fz", data=np.array([file["n"].ref] * 50, dtype=h5py.ref_dtype))


def promised(file, folder):
    file.create_dataset("Fz", (10**12,), float, chunks=(1000,), compression="gzip")


def promised_with_some(file, folder):
    file.create_dataset("Fz", (10**12,), float, chunks=(1000,), compression="gzip")[:1000] = 1.0


def never_written(file, folder):
    file.create_dataset("Fz", (10**6,), float)


@pytest.mark.parametrize(("make", "sentence"), [
    (external_link, "link /Fz leads to secret.h5, another file"),
    (link_out_by_link, "link /Fz leads to /moved, which is nothing in the file|leads to secret.h5"),
    (soft_loop, "leads to /.*, which is nothing in the file"),
    (soft_to_itself, "leads to Fz, which is nothing"),
    (soft_to_nothing, "leads to /there/is/none, which is nothing"),
    (virtual, "dataset /Fz is made of other files or datasets"),
    (external_bytes, "dataset /Fz is made of other files"),
    (objects, "dataset /Fz is object; expected one row of numbers"),
    (references, "dataset /Fz is object"),
    (promised, "dataset /Fz claims 8e\\+12 bytes where the file has at most 0"),
    (promised_with_some, "dataset /Fz claims 8e\\+12 bytes where the file has at most"),
    (never_written, "dataset /Fz claims 8e\\+06 bytes where the file has at most 0"),
])  # fmt: skip
def test_hdf5_that_reaches_outside_or_promises_too_much_is_refused(tmp_path, make, sentence):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.attrs["rate"] = 1000.0
        make(file, tmp_path)
    for form in ("auto", "load-cell-hdf5"):
        refuses(path, sentence, format=form, units={"thrust": "N"}, datasets={"thrust": "/Fz"})


def test_links_inside_a_file_and_constant_signals_are_read(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.attrs["rate"] = 1000.0
        file.create_dataset("Fz", data=np.zeros(10**6), compression="gzip", shuffle=True).attrs["unit"] = "N"
        file["alias"] = h5py.SoftLink("/Fz")
        file["circle"] = file["/"]
    assert load(path)["thrust"].values.size == 10**6


def test_bytes_added_to_a_file_are_noted(tmp_path):
    path = hdf5(tmp_path / "log.h5", {"Fz": ("N", ONES)}, rate=1000.0)
    assert "bytes were lost or added" not in notes(load(path))
    path.write_bytes(path.read_bytes() + bytes(7))
    assert "bytes were lost or added" in notes(load(path))


def test_a_tdms_that_promises_more_samples_than_bytes(tmp_path):
    path = tdms(tmp_path / "log.tdms", [("cell", "Fz", ONES, {"wf_increment": 1e-3, "unit_string": "N"})])
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<IQ", 1, 50), struct.pack("<IQ", 1, 10**12), 1))
    assert path.read_bytes() != data
    log = load(path)
    assert log["thrust"].values.size == 50
    assert "Data size 400 is not a multiple of the chunk size" in notes(log)
    path.write_bytes(data[:12] + struct.pack("<Q", 10**12) + data[20:])
    log = load(path)
    assert log["thrust"].values.size == 50
    assert "bytes were lost or added" in notes(log)


def test_a_c3d_that_promises_more_frames_than_bytes_reads_what_is_there(tmp_path):
    path = c3d(tmp_path / "log.c3d", np.ones((20, 3, 3)))
    data = bytearray(path.read_bytes())
    struct.pack_into("<H", data, 8, 60000)
    path.write_bytes(data)
    log = load(path)
    assert "the header's number of frames is 60000 but" in notes(log)
    # The file is filled up to a whole block: 20 frames of 48 bytes and what else fits.
    assert 20 <= len(log["quad:0/position"].values) < 31


@pytest.fixture(scope="module")
def worker():
    with Worker() as process:
        yield process


@pytest.mark.parametrize("filling", [b"9", b",", b'"', b"a", b" "])
def test_a_line_of_50_mb_is_refused_before_it_takes_memory(worker, tmp_path, filling):
    head = b"Time (s),Command (us),Speed (rad/s),Fz (N)\n"
    path, whole = tmp_path / "log.csv", tmp_path / "whole.csv"
    whole.write_bytes(head + b"".join(b"%d,2,3,4\n" % i for i in range(20)))
    path.write_bytes(whole.read_bytes() + filling * 50_000_000 + b"\n")
    # The worker's limit of 20 times the file is 1 GB.
    answer = worker.outcome(path, whole, "load-cell-csv", {}, 1)
    assert answer["outcome"] == "refused"
    assert "line 22: 50 MB without a line end" in answer["what"]


def test_names_that_are_a_page_or_turn_the_line_are_shown_as_one_line(tmp_path):
    evil = "a\nb\u202e\x1b[31m" + "c" * 10_000
    path = hdf5(tmp_path / "log.h5", {evil: ("N", ONES), "x" + evil: ("N", ONES)}, rate=1000.0)
    sentence = refuses(path, 'no dataset "Fz" or "Mz"', format="load-cell-hdf5")
    assert len(sentence) < 1500
    assert not set("\u202e\x1b") & set(sentence)


def mcap_chunk(claimed, data, packing=b"lz4"):
    body = (
        struct.pack("<QQQII", 0, 1, claimed, 0, len(packing)) + packing + struct.pack("<Q", len(data)) + data
    )
    profile = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    records = ((1, profile), (6, body), (2, bytes(20)))
    mark = b"\x89MCAP0\r\n"
    return mark + b"".join(struct.pack("<BQ", kind, len(data)) + data for kind, data in records) + mark


def bag_chunk(claimed, data, packing=b"bz2"):
    fields = (b"op=\x05", b"compression=" + packing, b"size=" + struct.pack("<I", claimed))
    header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data
    return b"#ROSBAG V2.0\n" + chunk


def bomb():
    import lz4.frame

    return mcap_chunk(1000, lz4.frame.compress(bytes(1 << 30)))


@pytest.mark.parametrize(("data", "sentence"), [
    (lambda: mcap_chunk(10**12, b"x" * 50), "damaged or cut \\(LZ4F"),
    (lambda: bag_chunk(2**32 - 1, b"x" * 50), "damaged or cut"),
    (bomb, "reading it takes more than 0.268 GB of memory"),
])  # fmt: skip
def test_a_recording_that_unpacks_to_more_than_it_says(tmp_path, monkeypatch, data, sentence):
    monkeypatch.setattr(isolation, "_MEMORY", 1 << 28)
    path = tmp_path / "log.bag"
    path.write_bytes(data())
    refuses(path, sentence)


@pytest.mark.parametrize("computed", [
    "CREATE VIEW endless AS WITH RECURSIVE n(i) AS (SELECT 1 UNION SELECT i + 1 FROM n) SELECT i FROM n",
    "ALTER TABLE topics ADD COLUMN large AS (zeroblob(1000000000))",
])  # fmt: skip
def test_a_database_whose_content_is_computed(tmp_path, computed):
    turns = quaternions_of(small_turns(np.random.default_rng(1), 20))
    stamps = np.arange(20) * 10_000_000
    path = ros_recording(tmp_path, "sqlite", {"/quad": (stamps, np.zeros((20, 3)), turns, 0)})
    load(path)
    with sqlite3.connect(path) as base:
        base.execute(computed)
    base.close()
    refuses(path, "(endless|topics) is computed by SQLite, where a recording has plain tables")


@pytest.mark.parametrize("threads", [0, 2])
def test_a_reader_that_does_not_end_is_stopped(tmp_path, monkeypatch, threads):
    """Also in a thread, and where the parser goes on after every exception."""

    def stuck(source):
        while True:
            try:
                sum(range(10_000))
            except Exception:
                continue

    form = registry.LogFormat("stuck", "never ends", lambda source: registry.NO, stuck, {})
    monkeypatch.setattr(registry, "_built_in", lambda: {"stuck": form})
    monkeypatch.setattr(registry, "_TIME", 0.2)
    path = tmp_path / "log.csv"
    path.write_bytes(b"1")

    def refused(_):
        with pytest.raises(LogError, match=r"log.csv: not read after 0.2 s of processor time, far"):
            load(path, format="stuck")
        time.sleep(0.05)  # a second exception would arrive here

    if threads:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(refused, range(threads)))
    else:
        refused(0)
