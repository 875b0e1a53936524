"""A second file with its own clock, and a tachometer's pulses: offsets and speeds against known truth."""

import numpy as np
import pytest

from fakes.log_files import refuses
from sysid.errors import LogError
from sysid.loaders import load
from sysid.loaders.alignment import find_offset, join_recordings
from sysid.loaders.load_cell import pulse_speed
from sysid.recording import Channel, Provenance, Recording


def staircase(time, lag=0.05):
    """A speed that answers steps of a command, with its own timing: 0, 3, 7, 4 hundred rad/s."""
    speed = np.zeros(time.size)
    for at, step in ((1.0, 300.0), (2.3, 400.0), (4.1, -300.0)):
        speed += step * (1 - np.exp(-np.maximum(time - at, 0) / lag))
    return speed


def channel(name, time, values, unit="rad/s"):
    return Channel(name, unit, time, values)


@pytest.mark.parametrize("offset", [0.0, 1.2345, -37.5, 1.7e9])
@pytest.mark.parametrize("rate", [100.0, 85.3])
def test_offset_is_found_below_the_sample_period(offset, rate):
    random = np.random.default_rng(1)
    fine = np.arange(0, 6, 1e-3)
    first = channel("speed", fine, staircase(fine) + random.normal(size=fine.size))
    coarse = np.arange(0.3, 5.5, 1 / rate)
    second = channel("speed", coarse - offset, staircase(coarse) + random.normal(size=coarse.size) * 3)
    result = find_offset("other.csv", first, second)
    # A quarter of the slower file's sample period (10 to 12 ms); a clock in Unix seconds resolves 0.24 µs.
    assert result.offset == pytest.approx(offset, abs=2.5e-3)
    assert result.correlation > 0.8
    assert result.sure
    assert "offset" in result.sentence()


def test_thrust_aligns_with_speed_although_it_is_its_square():
    time = np.arange(0, 6, 2e-3)
    speed = channel("speed", time, staircase(time))
    thrust = channel("thrust", time[:2500] + 2.0, -1e-5 * staircase(time[:2500]) ** 2, "N")
    result = find_offset("b", speed, thrust, sign=False)
    # Speed itself would be 8 ms off, because its square lags it; squared, they are one curve at 2 ms.
    assert result.offset == pytest.approx(-2.0, abs=5e-4)


def test_periodic_signals_are_not_sure():
    time = np.arange(0, 20, 0.01)
    first, second = (channel("speed", time, np.sin(2 * np.pi * time + phase)) for phase in (0, 1))
    assert not find_offset("b", first, second).sure


def test_noise_is_not_sure_and_constants_are_refused():
    random = np.random.default_rng(2)
    time = np.arange(0, 10, 0.01)
    first, second = (channel("speed", time, random.normal(size=time.size)) for _ in range(2))
    assert not find_offset("b", first, second).sure
    with pytest.raises(LogError, match="never changes; align by another channel"):
        find_offset("b", first, channel("speed", time, np.ones(time.size)))
    with pytest.raises(LogError, match="too few to align by"):
        find_offset("b", first, channel("speed", time[:5], time[:5]))


def recording(path, **channels):
    made = {name: channel(name, *value) for name, value in channels.items()}
    return Recording("load-cell", made, Provenance(path, "00", "load-cell-csv"))


def test_join_moves_the_second_clock_and_says_so():
    time = np.arange(0, 6, 1e-3)
    late = np.arange(0, 5.5, 0.01)
    first = recording("cell.csv", speed=(time, staircase(time)), thrust=(time, time))
    second = recording("rpm.csv", speed=(late + 9, staircase(late)), voltage=(late + 9, late))
    joined, result = join_recordings(first, second, "speed")
    assert result.offset == pytest.approx(-9, abs=1e-3)
    assert set(joined.channels) == {"speed", "thrust", "voltage"}
    np.testing.assert_allclose(joined["voltage"].time, late, atol=1e-3)
    np.testing.assert_array_equal(joined["speed"].values, first["speed"].values)
    assert "joined with rpm.csv" in joined.provenance.sentences[-1]
    flat = recording("noise.csv", speed=(late, np.random.default_rng(0).normal(size=late.size)))
    with pytest.raises(LogError, match=r"noise\.csv: cannot be aligned with cell\.csv by speed"):
        join_recordings(first, flat, "speed")


@pytest.mark.parametrize("width", [0.1, 0.5])
@pytest.mark.parametrize("sign", [1, -1])
def test_pulses_become_speed(width, sign):
    random = np.random.default_rng(3)
    time = np.arange(0, 2, 1e-4)
    speed = 200 + 100 * time
    phase = 200 * time + 50 * time**2
    level = np.where((2 * phase / (2 * np.pi)) % 1 < width, 5.0, 0.0)
    values = sign * (level + random.normal(size=time.size) * 0.2)
    result, notes = pulse_speed("log", time, values, 2)
    assert result.unit == "rad/s"
    # An edge is known to a sample of 0.1 ms and a period is 7.9 to 15.7 ms: 1.3 %, of both edges 1.8 %.
    np.testing.assert_allclose(result.values, np.interp(result.time, time, speed), rtol=0.018)
    assert "2 per revolution" in str(notes[0])


def test_pulses_with_a_lost_stretch_and_without_any():
    time = np.arange(0, 1, 1e-3)
    values = np.where((20 * time) % 1 < 0.5, 1.0, 0.0)
    values[300:320] = np.nan
    result, _ = pulse_speed("log", time, values, 1)
    # The lost stretch holds an edge, so both periods that it bounds are unknown.
    assert np.isnan(result.values).sum() == 2
    np.testing.assert_allclose(result.values[result.valid], 40 * np.pi, rtol=0.03)
    with pytest.raises(LogError, match="shows 0 pulses"):
        pulse_speed("log", time, np.ones(time.size), 1)
    with pytest.raises(LogError, match="too fast to be told apart"):
        pulse_speed("log", time, np.arange(time.size) % 2.0, 1)


@pytest.mark.parametrize("shift", [0.0, 0.013])
def test_a_period_across_missing_rows_has_no_speed(shift):
    # Rows that were never written leave no NaN behind, only a longer step of the clock.
    time = np.arange(0, 1, 1e-3)
    values = np.where((50 * time) % 1 < 0.5, 1.0, 0.0)
    kept = (time < 0.402 + shift) | (time > 0.7015 + shift)
    result, notes = pulse_speed("log", time[kept], values[kept], 1)
    assert 1 <= np.isnan(result.values).sum() <= 2
    # Between samples of 1 ms an edge of a 20 ms period is known to 5 %, far from the 0.3 s of the hole.
    np.testing.assert_allclose(result.values[result.valid], 100 * np.pi, rtol=0.05)
    assert "holes in the clock of the tachometer: 1 (the longest 0.3" in str(notes[-1])


def test_tachometer_column_of_a_load_cell(write):
    rows = "".join(f"{i * 1e-3:.3f},{i},{5 * (i % 20 < 10)}\n" for i in range(200))
    path = write("Time (s),Fz (N),Tachometer (V)\n" + rows, "cell.csv")
    assert "declare pulses_per_revolution" in " ".join(load(path).provenance.sentences)
    log = load(path, pulses_per_revolution=2)
    np.testing.assert_allclose(log["speed"].values, 2 * np.pi / (2 * 0.02), rtol=1e-9)
    assert log.provenance.options["pulses_per_revolution"] == "2"
    refuses(path, "pulses_per_revolution = 0 is no positive number", pulses_per_revolution=0)
    path.write_text("Time (s),Fz (N)\n0,1\n1,2\n", encoding="utf-8")
    refuses(path, "no tachometer is found", pulses_per_revolution=1)
