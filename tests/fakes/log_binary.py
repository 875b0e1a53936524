"""Small logs of every binary format, written by the libraries of their formats, and how each is damaged.

A log is bytes; a damage takes bytes and a random generator and returns bytes.
"""

import io
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np

from fakes.log_files import c3d, quaternions_of, ros_recording, small_turns, tdms
from sysid.loaders import load
from sysid.loaders.readers.sysid_hdf5 import write_recording

# Numbers that lengths and counts become.
_COUNTS = (0, 1, 2, 3, 7, 127, 255, 256, 4095, 32767, 65535, 2**20, 2**24, 2**31 - 1, 2**31, 2**32 - 1)


def _hdf5(stream):
    random = np.random.default_rng(5)
    with h5py.File(stream, "w") as file:
        file.attrs["rate"] = 10000.0
        for name, unit in {"Command": "us", "Speed": "rad/s", "Fz": "N", "Mz": "N·m"}.items():
            data = file.create_dataset(name, data=random.normal(size=200), compression="gzip", chunks=(50,))
            data.attrs["unit"] = unit


def cell_hdf5():
    stream = io.BytesIO()
    _hdf5(stream)
    return stream.getvalue()


def _sysid_hdf5(folder):
    source = folder / "cell.h5"
    source.write_bytes(cell_hdf5())
    return write_recording(load(source), folder / "log.h5")


def _mat(folder, compressed=True):
    from scipy.io import savemat

    random = np.random.default_rng(6)
    content = {name: random.normal(size=60) for name in ("Command", "Speed", "Fz", "Mz")}
    content |= {"time": np.arange(60) * 1e-3, "note": "by hand", "FT": random.normal(size=(60, 3))}
    content["cell"] = {"data": random.normal(size=60), "unit": "V", "rate": 1000.0}
    savemat(folder / "log.mat", content, do_compression=compressed)
    return folder / "log.mat"


MAT_UNITS = {"time": "s", "Command": "us", "Speed": "rad/s", "Fz": "N", "Mz": "N*m"}


def _mat73(folder):
    path = folder / "log.mat"
    random = np.random.default_rng(7)
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("time", *MAT_UNITS):
            if name not in file:
                values = np.arange(60) * 1e-3 if name == "time" else random.normal(size=60)
                file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    data = bytearray(path.read_bytes())
    data[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(data)
    return path


def _tdms(folder):
    random = np.random.default_rng(8)
    waves = [
        ("cell", name, random.normal(size=50),
         {"wf_increment": 1e-3, "wf_start_offset": 0.0, "unit_string": unit})
        for name, unit in (("Fz", "N"), ("Mz", "N*m"), ("Strain", "V"))
    ]  # fmt: skip
    return tdms(folder / "log.tdms", waves, waves)


def _c3d(folder):
    random = np.random.default_rng(9)
    points = (random.normal(size=(20, 4, 3)) * 100).astype(np.float32).astype(float)
    return c3d(folder / "log.c3d", points, analogs={"Fz": ("N", random.normal(size=40))})


def _ros(form):
    def write(folder):
        random = np.random.default_rng(11)
        stamps = 1_700_000_000_000_000_000 + np.arange(20) * 10_000_000
        turns = quaternions_of(small_turns(random, 20))
        return ros_recording(folder, form, {"/quad/pose": (stamps, random.normal(size=(20, 3)), turns, 1000)})

    return write


def _cell_file(folder):
    path = folder / "log.h5"
    path.write_bytes(cell_hdf5())
    return path


# name: (format, writer into a folder, options)
_WRITERS = {
    "load-cell-hdf5": ("load-cell-hdf5", _cell_file, {}),
    "sysid-hdf5": ("sysid-hdf5", _sysid_hdf5, {}),
    "mat": ("mat", _mat, {"units": MAT_UNITS}),
    "mat-plain": ("mat", lambda folder: _mat(folder, compressed=False), {"units": MAT_UNITS}),
    "mat-7.3": ("mat", _mat73, {"units": MAT_UNITS}),
    "tdms": ("tdms", _tdms, {}),
    "c3d": ("c3d", _c3d, {}),
    "ros-bag": ("ros-bag", _ros("bag"), {}),
    "ros-mcap": ("ros-bag", _ros("mcap"), {}),
    "ros-sqlite": ("ros-bag", _ros("sqlite"), {}),
}
BINARY = tuple(_WRITERS)


@cache
def binary_log(name):
    """Return (format, bytes, options) of a whole log."""
    form, write, options = _WRITERS[name]
    with TemporaryDirectory() as folder:
        return form, Path(write(Path(folder))).read_bytes(), options


def cut(data, random):
    return data[: int(random.integers(0, len(data)))]


def flip(data, random):
    changed = bytearray(data)
    for _ in range(int(random.integers(1, 5))):
        changed[int(random.integers(0, len(changed)))] ^= 1 << int(random.integers(0, 8))
    return bytes(changed)


def flip_early(data, random):
    """Most formats begin with what the rest depends on."""
    head = min(len(data), 2048)
    return flip(data[:head], random) + data[head:]


def splash(data, random):
    at, size = int(random.integers(0, len(data))), int(random.integers(1, 30))
    return data[:at] + random.bytes(size) + data[at + size :]


def inserted(data, random):
    at = int(random.integers(0, len(data)))
    return data[:at] + random.bytes(int(random.integers(1, 30))) + data[at:]


def removed(data, random):
    at = int(random.integers(0, len(data)))
    return data[:at] + data[at + int(random.integers(1, 100)) :]


def other_count(data, random):
    """A word of one to eight bytes becomes another number, in either byte order; often near the start."""
    changed = bytearray(data)
    last = min(len(data), 2048) if random.random() < 0.5 else len(data)
    size = int(random.choice([1, 2, 4, 8]))
    number = int(random.choice(_COUNTS)) & (256**size - 1)
    at = int(random.integers(0, max(last - size, 1)))
    changed[at : at + size] = number.to_bytes(size, "little" if random.random() < 0.7 else "big")
    return bytes(changed[: len(data)])


def doubled(data, random):
    """A stretch of the file stands twice, or in another place."""
    at, size = int(random.integers(0, len(data))), int(random.integers(1, 600))
    to = int(random.integers(0, len(data)))
    return data[:to] + data[at : at + size] + data[to + (size if random.random() < 0.5 else 0) :]


def blanked(data, random):
    at, size = int(random.integers(0, len(data))), int(random.integers(1, 300))
    piece = data[at : at + size]
    return data[:at] + bytes([0, 255][int(random.integers(0, 2))] for _ in piece) + data[at + size :]


DAMAGES = (cut, flip, flip_early, splash, inserted, removed, other_count, doubled, blanked)
