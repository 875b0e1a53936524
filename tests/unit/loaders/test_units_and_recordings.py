"""Unit strings of instruments and campaigns to SI; recordings that cannot be changed."""

import json
import math
import re

import h5py
import numpy as np
import pytest

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders import load
from sysid.loaders.readers.sysid_hdf5 import write_recording
from sysid.loaders.signal_log import plain_unit, written_unit
from sysid.recording import Channel, Provenance, Recording
from sysid.units import factor_to_si, parse_quantity


@pytest.mark.parametrize("unit", ["1/min", "min⁻¹", "min^-1", "min-1", "U/min", "r/min"])
def test_revolutions_per_minute_go_by_many_names(write, unit):
    assert factor_to_si(unit, "rad/s") == pytest.approx(math.pi / 30, rel=1e-12)
    rows = "".join(f"{i * 0.01:.2f},{60 * i},1.0\n" for i in range(20))
    log = load(write(f"Time (s),RPM [{unit}],Fz (N)\n{rows}", "log.csv"))
    assert log["speed"].values[1] == pytest.approx(2 * math.pi, rel=1e-12)


def test_a_frequency_stays_a_frequency():
    assert factor_to_si("1/min", "Hz") == pytest.approx(1 / 60, rel=1e-12)
    with pytest.raises(UnitError):
        factor_to_si("1/s", "rad/s")


@pytest.mark.parametrize(("text", "expected", "sentence"), [
    ("36.4 %", "deg", "the angle atan(p/100), so write '20 deg' for 36.4 %"),
    ("20 deg deg", "deg", "an angle that the other lacks"),
    ("20 m/m", "rad", "an angle that the other lacks"),
    ("1 sr", "rad", "an angle that the other lacks"),
    ("408 rad/s", "Hz", "an angle that the other lacks"),
    ("2 deg", "1", "an angle that the other lacks"),
    ("0.5 N·m", "N·m/rad", "an angle that the other lacks"),
])  # fmt: skip
def test_a_unit_with_an_angle_is_none_without(text, expected, sentence):
    with pytest.raises(UnitError, match=re.escape(sentence)):
        parse_quantity(text, expected)


@pytest.mark.parametrize(
    "unit", ["m*9**9**9**9", "m*(9)**(9)**(9)**(9)", "m*9⁹**9**9", "m^(9^9^9)", "m" * 10**6]
)
def test_a_unit_of_endless_digits_is_no_unit(unit):
    with pytest.raises(UnitError, match="unknown unit"):
        parse_quantity(f"1 {unit}", "m")


def test_a_broken_installation_is_no_typo(monkeypatch):
    def missing():
        raise ImportError("pint lacks flexparser")

    monkeypatch.setattr("sysid.units._registry", missing)
    with pytest.raises(ImportError):
        factor_to_si("parsec·fortnight")


@pytest.mark.parametrize(("unit", "factor"), [
    ("RPM", math.pi / 30),
    ("rev/s", 2 * math.pi),
    ("gf", 9.80665e-3),
    ("kgf", 9.80665),
    ("lbf", 4.4482216152605),
    ("lbf-in", 0.1129848290276167),
    ("N·m", 1.0),
    ("mNm", 1e-3),
    ("µs", 1e-6),  # both code points of micro
    ("μs", 1e-6),
    ("kg·m²", 1.0),
    ("kg.m2", 1.0),
    ("g·cm²", 1e-7),
    ("rpm/V", math.pi / 30),
    ("N·s/m", 1.0),
    ("deg", math.pi / 180),
    ("mH", 1e-3),
    ("kHz", 1e3),
])  # fmt: skip
def test_units_of_the_field(unit, factor):
    assert factor_to_si(unit) == pytest.approx(factor, rel=1e-12)


def test_quantities():
    assert parse_quantity("1.242 kg", "kg") == 1.242
    assert parse_quantity(" -2.5e-3 m ", "mm") == -2.5e-3
    assert parse_quantity("0.44", "1") == 0.44
    assert parse_quantity("30min", "s") == 1800


@pytest.mark.parametrize(("text", "expected", "sentence"), [
    ("1.242", "kg", "has no unit; expected for example '1.242 kg'"),
    ("105", "m", "has no unit; expected for example '105 mm'"),
    ("heavy", "kg", "is not a number with a unit"),
    ("1,242 kg", "kg", "has a comma; write a point before decimals"),
    ("1 kgg", "kg", "unknown unit 'kgg'"),
    ("1 g", "N", "did you mean 'gf', the weight of that mass"),
    ("1 N", "kg", "unit 'N' is not a 'kg'"),
    # A frequency is no angular speed: 50 Hz would silently be 50 rad/s.
    ("50 Hz", "rad/s", "unit 'Hz' is not a 'rad/s'"),
    # As a factor, a degree Celsius would be 274.15 K.
    ("20 degC", "K", "unit 'degC' has another zero than 'K'"),
])  # fmt: skip
def test_refused_quantities(text, expected, sentence):
    with pytest.raises(UnitError, match=sentence):
        parse_quantity(text, expected)


def test_channels_are_locked_and_share_a_locked_clock():
    time = np.arange(5.0)
    first = Channel("speed", "rad/s", time, np.ones(5))
    second = Channel("thrust", "N", first.time, [1.0, np.nan, 2.0, 3.0, 4.0])
    time[0] = 99.0
    assert first.time[0] == 0.0  # a caller's array is copied, not frozen under its hands
    assert second.time is first.time
    assert second.valid.tolist() == [True, False, True, True, True]
    for array in (first.time, first.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(ValueError, match="time does not increase"):
        Channel("speed", "rad/s", [0.0, 0.0], [1.0, 2.0])


def test_a_missing_channel_names_those_there_are():
    recording = Recording(
        "thrust-stand", {"speed": Channel("speed", "rad/s", [0.0], [1.0])}, Provenance("a.csv", "", "x")
    )
    with pytest.raises(LogError, match=r"a\.csv: no channel 'torque'; found speed"):
        recording["torque"]


@pytest.mark.parametrize(("stated", "unit", "factor"), [
    ("%", "1", 0.01),
    ("strain", "1", 1.0),
    ("dB", "", 1.0),
    ("dBm", "", 1.0),
    ("mrad", "rad", 1e-3),
    ("rad/s", "rad/s", 1.0),
    ("mV", "V", 1e-3),
    ("Volts", "V", 1.0),  # in words
    # Gram or standard gravity, and scales with an offset: never guessed.
    ("g", "", 1.0),
    ("degC", "", 1.0),
    (None, "", 1.0),
])  # fmt: skip
def test_plain_units(stated, unit, factor):
    assert plain_unit(written_unit(stated)) == (unit, pytest.approx(factor))


def test_a_log_is_never_replaced_by_its_conversion(write, run):
    log = write("Time (s),Speed (rad/s)\n0,1\n0.01,2\n0.02,3\n", "log.csv")
    before = log.read_bytes()
    code, _, err = run("convert", log, "--out", log, "--force")
    assert code == 2
    assert "is the log itself" in err
    assert log.read_bytes() == before


def test_notes_of_a_conversion_keep_their_codes_and_plain_texts_are_read(tmp_path):
    """Files of older versions hold the sentence of a note alone."""
    channels = {"speed": Channel("speed", "rad/s", [0.0], [1.0])}
    noted = (note("speed-source", "speed is the optical one"), Finding("pole-count", "wrong poles"))
    path = write_recording(
        Recording("thrust-stand", channels, Provenance("a.csv", "", "x", notes=noted)), tmp_path / "a.h5"
    )
    assert load(path).provenance.notes[:-1] == noted
    with h5py.File(path, "a") as file:
        file.attrs["notes"] = json.dumps(["an old note"])
    assert load(path).provenance.notes[:-1] == (note("stated", "an old note"),)
