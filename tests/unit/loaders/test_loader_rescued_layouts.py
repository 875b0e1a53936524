"""Layouts that other programs leave behind, and advice that can be followed."""

import h5py
import numpy as np
import pytest

from sysid.errors import LogError
from sysid.loaders import load

_VICON = (
    "Trajectories,,,,\n100,,,,\n,,a:m1,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,0,2,3\n2,0,1,2,3\n{blank}\n"
    "Devices,,,,\n200,,,,\n,,cell,,\nFrame,Sub Frame,Fz,,\n,,N,,\n1,0,5,,\n1,1,6,,\n{last},0,7,,\n2,1,8,,\n"
)


@pytest.mark.parametrize("blank", ["", ",,,,", "  ", ";\t "])
def test_vicon_sections_are_parted_by_any_blank_line(tmp_path, blank):
    path = tmp_path / "log.csv"
    path.write_text(_VICON.format(blank=blank, last=2), encoding="utf-8", newline="\n")
    log = load(path)
    assert list(log["a:m1/position"].values[:, 0]) == [0.0, 1e-3]
    assert list(log["cell/Fz"].values) == [5.0, 6.0, 7.0, 8.0]


def test_a_format_without_time_back_does_not_advise_it(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(_VICON.format(blank="", last=0), encoding="utf-8", newline="\n")
    with pytest.raises(LogError, match="time goes back") as refusal:
        load(path)
    assert "time_back" not in str(refusal.value)


def test_hdf5_unit_may_be_an_array_of_one_text(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.attrs["rate"] = 100.0
        file["Fz"] = np.arange(20.0)
        file["Fz"].attrs["unit"] = np.array([b"mN"])
    assert load(path)["thrust"].values[10] == pytest.approx(0.01, rel=1e-12)
