"""Logs with headers in disorder and absurd numbers end in one sentence, or are read as what they say."""

import warnings
from itertools import combinations

import h5py
import numpy as np
import pytest

from fakes.log_files import notes, refuses
from fakes.log_samples import LOGS
from sysid.errors import SysidError
from sysid.loaders import load
from sysid.loaders.readers.sysid_hdf5 import write_recording
from sysid.trials.look import inspect_recording


@pytest.mark.parametrize("labels", [True, False], ids=["labelled rows", "rows of Motive 1.21"])
def test_any_two_rows_of_a_motive_header_exchanged_are_read_right_or_refused(write, labels):
    data = LOGS["motive-csv"].data
    if not labels:
        for label in (b",Type,", b",Name,", b",ID,"):
            data = data.replace(label, b",,")
    whole = load(write(data), format="motive-csv")
    lines, read = data.split(b"\r\n"), 0
    for first, second in combinations(range(7), 2):
        rows = list(lines)
        rows[first], rows[second] = rows[second], rows[first]
        try:
            damaged = load(write(b"\r\n".join(rows)), format="motive-csv")
        except SysidError:
            continue
        read += 1
        if labels:
            for name, channel in whole.channels.items():
                np.testing.assert_array_equal(damaged[name].values, channel.values)
    assert read


def test_a_motive_header_whose_components_stand_above_the_types_is_refused(write):
    data = LOGS["motive-csv"].data
    for label in (b",Type,", b",Name,", b",ID,"):
        data = data.replace(label, b",,")
    rows = data.split(b"\r\n")
    rows[2], rows[5] = rows[5], rows[2]
    refuses(write(b"\r\n".join(rows)), "row of components .* stands above the row of types")


def test_a_count_of_samples_of_5000_digits_is_no_count(write):
    data = LOGS["lvm"].data
    whole = load(write(data))
    damaged = load(write(data.replace(b"Samples\t40", b"Samples\t" + b"9" * 5000)))
    np.testing.assert_array_equal(damaged["thrust"].values, whole["thrust"].values)


def test_numbers_that_nothing_measures_are_missing(write, tmp_path):
    rows = LOGS["load-cell-csv"].data.decode().split("\n")
    cells = rows[5].split(",")
    cells[3] = "-1e308"
    rows[5] = ",".join(cells)
    log = load(write("\n".join(rows)))
    assert np.isnan(log["thrust"].values[4])
    assert "numbers beyond 1e+100, taken as missing: in thrust" in notes(log)
    write_recording(load(write(LOGS["load-cell-csv"].data)), tmp_path / "own.h5")
    with h5py.File(tmp_path / "own.h5", "a") as file:
        file["channels/thrust"][3] = -1e308
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert any("beyond 1e+100" in str(doubt) for doubt in inspect_recording(log).suspicions)
        inspect_recording(load(tmp_path / "own.h5"))


def test_a_channel_without_a_name_is_refused(write, tmp_path):
    write_recording(load(write(LOGS["load-cell-csv"].data)), tmp_path / "own.h5")
    with h5py.File(tmp_path / "own.h5", "a") as file:
        file["channels/thrust"].attrs["name"] = ""
    refuses(tmp_path / "own.h5", "channel at /channels/thrust has no name, so the file is damaged")
