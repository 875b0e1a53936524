"""Numbers of use, read from known tracks: where a body rests, how far it tilts, when its feet touch."""

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.gear.story import _read
from sysid.trials.fall import Feet

RATE, DX, DZ, SLOPE = 200.0, 0.1, 0.15, np.radians(20)


def slid(clock, rest, way):
    """A body that touches with both feet at 0 s, slides by a way [m] until it rests, and tilts by 3 deg."""
    along = way * np.clip(clock / rest, 0.0, 1.0)
    height = DZ + np.where(clock < 0, -0.5 * clock, 0.0) - 1e-4 * (clock >= 0)
    pitch = SLOPE + np.radians(3) * np.sin(np.pi * np.clip(clock / rest, 0, 1)) * (clock > 0)
    x = along * np.cos(SLOPE) + height * np.sin(SLOPE)
    z = -along * np.sin(SLOPE) + height * np.cos(SLOPE)
    return np.column_stack([x, z, pitch])


@pytest.fixture
def drop():
    flight = SimpleNamespace(at=lambda time: np.array([[DZ * np.sin(SLOPE), DZ * np.cos(SLOPE), 0.0]]))
    feet = Feet(DX, DZ, SLOPE)
    return SimpleNamespace(
        touchdown=10.0, feet=feet, slope=SLOPE, flight=flight, motion=SimpleNamespace(rate=RATE)
    )


@pytest.mark.parametrize("samples", [241, 240, 15, 14])
def test_tracks_are_read_as_they_were_made(drop, samples):
    """Also tracks that are shorter than what smooths their rates."""
    clock = 10.0 + (np.arange(samples) - 10) / RATE
    tracks = np.stack([slid(clock - 10.0, rest, way) for rest, way in ((0.5, 0.2), (0.4, 0.3))])
    read = _read(drop, clock, tracks, clock[-1], None)
    numbers = {one.what: one.values for one in read.numbers}
    if samples < 20:
        assert read.ends == ["still moving"] * 2
        assert np.isnan(numbers["rest place"]).all()
        return
    np.testing.assert_allclose(numbers["rest place"], [20.0, 30.0], atol=0.5)
    np.testing.assert_allclose(numbers["time to rest"], [500.0, 400.0], atol=40.0)
    np.testing.assert_allclose(numbers["largest pitch"], 23.0, atol=0.01)
    assert read.ends == ["at rest"] * 2
    # A board of 25 cm ends before the second body rests.
    assert _read(drop, clock, tracks, clock[-1], 0.25).ends == ["at rest", "left the board"]
    # What rests later than a measurement of this log would show counts as moving.
    assert _read(drop, clock, tracks, clock[-1], None, late=0.7).ends == ["still moving", "at rest"]


def test_a_body_that_turns_over_has_flipped(drop):
    clock = 10.0 + (np.arange(240) - 10) / RATE
    track = slid(clock - 10.0, 0.5, 0.2)
    track[120:, 2] += np.radians(81)
    lost = np.full_like(track, np.nan)
    read = _read(drop, clock, np.stack([track, lost]), clock[-1], None)
    assert read.ends == ["flipped", "simulation failed"]
    assert all(np.isnan(one.values[1]) for one in read.numbers)


def test_touchdowns_are_where_unloaded_feet_pass_the_surface(drop):
    """A body that comes down at 0.5 m/s, leaves the surface by 2 cm, and comes down again."""
    clock = 10.0 + (np.arange(300) - 20) / RATE
    height = np.interp(
        clock - 10.0, [-0.1, 0.0, 0.1, 0.3, 0.5, 2.0], [0.05, 0.0, -0.002, 0.02, -0.002, -0.002]
    )
    track = np.column_stack([
        (DZ + height) * np.sin(SLOPE), (DZ + height) * np.cos(SLOPE), np.full(300, SLOPE),
    ])  # fmt: skip
    numbers = {one.what: one.values[0] for one in _read(drop, clock, track[None], clock[-1], None).numbers}
    second = 1000 * (0.3 + 0.2 * 0.02 / 0.022)
    for foot in ("rear", "front"):
        assert numbers[f"touchdown, first of the {foot} foot"] == pytest.approx(0.0, abs=0.1)
        assert numbers[f"touchdown, second of the {foot} foot"] == pytest.approx(second, abs=0.1)
