"""Motion-capture logs to planar drops: axes, clock, plane, release, touchdown, initial state, refusals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid.errors import LogError
from sysid.recording import Channel, Provenance, Recording
from sysid.trials.capture import CaptureFrame, held_level, marker_plane, planar_motion, spatial_motion
from sysid.trials.fall import Feet, find_fall, fit_flight

G = 9.81
SLOPE = np.radians(15.0)
FEET = Feet(0.105, 0.151, SLOPE)
RELEASE = 7.4137  # on a clock that starts at 6.2 s
SPEED = 0.6
X = 0.3  # down-slope of the surface's origin
FRAME = CaptureFrame("+y", "+x")


def _log(time, position, quaternion=(1.0, 0.0, 0.0, 0.0)):
    channels = {
        "F450/position": Channel("F450/position", "m", time, position),
        "F450/orientation": Channel("F450/orientation", "1", time, quaternion * np.ones((len(time), 1))),
    }
    return Recording("motion-capture", channels, Provenance("drop.csv", "", "made"))


def _fall(time, speed=SPEED):
    """Height above the surface's origin, held, then falling so that the rear foot touches at `speed`."""
    touching = FEET.dz + (FEET.dx - X) * np.tan(SLOPE)
    elapsed = np.maximum(0.0, time - RELEASE)
    contact = RELEASE + speed / G
    height = touching + speed**2 / (2 * G) - 0.5 * G * elapsed**2
    # After contact: any motion that is no fall; it must not enter the fit.
    return np.where(time > contact, touching - 0.02 * np.sin(20 * (time - contact)), height)


def _recording(
    frame, *, rate=200.0, seconds=2.0, noise=0.0, offset=(0.0, 0.0, 0.0), built=None, drop_rows=(), seed=0
):
    """A level body at plane coordinates (x, 0, z) in the capture's own axes, body axes turned by `built`."""
    rng = np.random.default_rng(seed)
    time = 6.2 + np.arange(int(seconds * rate)) / rate
    plane = np.column_stack([np.full(time.size, X), np.zeros(time.size), _fall(time)])
    plane += rng.normal(scale=noise, size=plane.shape) if noise else 0.0
    pitch = np.where(time > RELEASE + SPEED / G, 2.0 * (time - RELEASE - SPEED / G), 0.0)
    in_plane = Rotation.from_rotvec(np.outer(pitch, [0.0, 1.0, 0.0])).as_matrix()
    built = np.eye(3) if built is None else built
    rotation = frame.matrix.T @ in_plane @ built
    position = plane @ frame.matrix - rotation @ np.asarray(offset)
    quaternion = Rotation.from_matrix(rotation).as_quat()[:, [3, 0, 1, 2]]
    keep = np.setdiff1d(np.arange(time.size), drop_rows)
    return _log(time[keep], position[keep], quaternion[keep])


def _prepare(recording, frame, **options):
    motion = spatial_motion(recording, None, frame, **options)
    held = find_fall(motion, G, "drop.csv")
    planar = planar_motion(motion, np.zeros(3), held_level(motion, held))
    return planar, held, *fit_flight(planar, FEET, held, G, "drop.csv")


@pytest.mark.parametrize(("up", "down"), [("+y", "+x"), ("+z", "-y"), ("-x", "+z"), ("+y", "-z")])
def test_release_touchdown_and_state_in_any_capture_axes(up, down):
    frame = CaptureFrame(up, down)
    # A body whose own axes were built askew and whose origin is not its centre of mass.
    built = Rotation.from_euler("xyz", [20, -35, 70], degrees=True).as_matrix()
    offset = (0.01, -0.02, 0.03)
    recording = _recording(frame, built=built, offset=offset)
    planar, _, flight, touchdown = _prepare(recording, frame, centre_of_mass_offset=offset)
    # 1e-6 s: the tolerance of the bounded search for the release.
    assert flight.start == pytest.approx(RELEASE, abs=1e-6)
    assert touchdown == pytest.approx(RELEASE + SPEED / G, abs=1e-6)
    assert flight.measured_gravity == pytest.approx(G, rel=1e-3)
    at_contact = flight.at(np.array([touchdown]))[0]
    assert at_contact == pytest.approx([X, _fall(np.array([touchdown]))[0], 0, 0, -SPEED, 0], abs=1e-5)
    after = planar.time > touchdown + 0.01
    assert planar.pitch[after] == pytest.approx(2.0 * (planar.time[after] - touchdown), abs=1e-5)
    assert np.nanmax(np.abs(planar.roll)) < 1e-9
    assert np.nanmax(np.abs(planar.yaw)) < 1e-9


def test_noise_moves_release_by_less_than_its_estimate():
    errors = []
    for seed in range(20):
        _, _, flight, _ = _prepare(_recording(FRAME, noise=0.3e-3, seed=seed), FRAME)
        errors.append(flight.start - RELEASE)
        # At rest: no rate is invented from noise in most draws, and none beyond 3 sigma (2 mm/s each).
        assert abs(flight.state[3]) < 0.012
    # sigma = noise / (g sqrt(sum of squared fall times)) = 0.3e-3 / (9.81 * 0.122) = 0.25 ms for 12 samples.
    assert np.std(errors) < 2 * 0.25e-3


def test_free_flight_backward_through_the_hold_meets_the_fall():
    """A simulation that starts before the release, falling freely, is on the flight from the release on."""
    _, _, flight, touchdown = _prepare(_recording(FRAME), FRAME)
    early, later = flight.start - 0.003, touchdown - 0.005
    state = flight.at(np.array([early]), free=True)[0]
    span = later - early
    fallen = state[:3] + span * state[3:] - [0, 0.5 * G * span**2, 0]
    assert fallen == pytest.approx(flight.at(np.array([later]))[0, :3], abs=1e-12)
    # The hold itself stands still.
    assert flight.at(np.array([early]))[0] == pytest.approx(flight.state, abs=1e-12)


def test_signs_of_roll_and_yaw():
    frame = CaptureFrame("+z", "+x")
    time = np.arange(10) / 100
    turns = {
        "roll": Rotation.from_rotvec([0.1, 0, 0]),
        "pitch": Rotation.from_rotvec([0, 0.2, 0]),
        "yaw": Rotation.from_rotvec([0, 0, 0.3]),
    }
    for name, turn in turns.items():
        recording = _log(time, np.zeros((10, 3)), turn.as_quat()[[3, 0, 1, 2]])
        planar = planar_motion(spatial_motion(recording, "F450", frame), np.zeros(3), np.eye(3))
        expected = {"roll": 0.0, "pitch": 0.0, "yaw": 0.0, name: np.linalg.norm(turn.as_rotvec())}
        for angle, value in expected.items():
            assert getattr(planar, angle) == pytest.approx(np.full(10, value), abs=1e-12)


def test_missing_frames_become_masked_slots_of_the_same_clock():
    motion = spatial_motion(_recording(FRAME, drop_rows=[50, 51, 52, 200]), None, FRAME)
    assert len(motion.time) == 400
    assert np.flatnonzero(~motion.valid).tolist() == [50, 51, 52, 200]
    assert motion.rate == pytest.approx(200.0, rel=1e-9)


def test_arrival_jitter_is_interpolated_and_said():
    rng = np.random.default_rng(3)
    time = np.arange(300) / 100 + rng.uniform(-0.002, 0.002, 300)
    recording = _log(time, np.outer(time, [1.0, 2.0, 3.0]))
    motion = spatial_motion(recording, None, CaptureFrame("+z", "+x"), rate=100.0)
    assert [note.code for note in motion.notes] == ["clock-jitters"]
    assert motion.valid.mean() > 0.97
    assert motion.position[motion.valid, 0] == pytest.approx(motion.time[motion.valid], abs=1e-9)


def test_plane_from_markers():
    normal = np.array([np.sin(SLOPE), 0, np.cos(SLOPE)])
    tangent = np.array([np.cos(SLOPE), 0, -np.sin(SLOPE)])
    across = np.array([0.0, 1.0, 0.0])
    origin = np.array([0.4, 0.1, 0.9])
    places = [origin + a * tangent + b * across + 0.007 * normal for a, b in [(0, 0), (0.5, 0), (0.2, 0.4)]]
    time = np.arange(5) / 100
    channels = {
        f"m{i}/position": Channel(f"m{i}/position", "m", time, np.tile(p @ FRAME.matrix, (5, 1)))
        for i, p in enumerate(places)
    }
    recording = Recording("motion-capture", channels, Provenance("board.csv", "", "made"))
    point, slope, _ = marker_plane(recording, ("m0", "m1", "m2"), FRAME, 0.007, None)
    assert slope == pytest.approx(SLOPE, abs=1e-12)
    assert (point - origin) @ normal == pytest.approx(0, abs=1e-12)
    single, *_ = marker_plane(recording, ("m1",), FRAME, 0.007, SLOPE)
    assert (single - origin) @ normal == pytest.approx(0, abs=1e-12)
    with pytest.raises(LogError, match=r"board.csv: no marker 'm9'; found m0, m1, m2"):
        marker_plane(recording, ("m9",), FRAME, 0.0, SLOPE)


def test_a_thrown_body_is_ballistic():
    time = np.arange(60) / 200
    position = np.column_stack([0.5 * time, 0 * time, 0.30 + 0.4 * time - 0.5 * G * time**2])
    motion = spatial_motion(_log(time, position), None, CaptureFrame("+z", "+x"))
    held = find_fall(motion, G, "made")
    assert held.start == held.stop
    planar = planar_motion(motion, np.zeros(3), np.eye(3))
    flight, touchdown = fit_flight(planar, Feet(0.105, 0.151, 0.0), held, G, "made")
    assert not flight.held
    expected = (0.4 + np.sqrt(0.4**2 + 2 * G * (0.30 - FEET.dz))) / G
    assert touchdown == pytest.approx(expected, abs=1e-6)
    assert flight.at(np.array([0.1]))[0] == pytest.approx(
        [0.05, 0.30 + 0.04 - 0.05 * G * 0.1, 0, 0.5, 0.4 - 0.1 * G, 0], abs=1e-9
    )


def _long_hold(moved_at=None, turned_at=None, noise_deg=0.0, seconds=4.0):
    """A hold of nearly `seconds` before the fall; moved by 5 mm or turned by 3 deg up to an instant."""
    time = RELEASE + 0.2 - seconds + np.arange(int(seconds * 200)) / 200
    position = np.column_stack([np.full(time.size, X), np.zeros(time.size), _fall(time)])
    if moved_at is not None:
        position[time < moved_at, 1] += 5e-3
    angle = np.random.default_rng(4).normal(scale=np.radians(noise_deg), size=time.size)
    if turned_at is not None:
        angle[time < turned_at] += np.radians(3.0)
    return _log(time, position, np.column_stack([np.cos(angle / 2), 0 * angle, np.sin(angle / 2), 0 * angle]))


@pytest.mark.parametrize(
    ("change", "begin"),
    [
        # The fall is seen to begin within some samples of the release; what counts ends half a window
        # (5 samples) before, at the earliest 2 s before that.
        ({}, RELEASE - 2.0),
        ({"moved_at": RELEASE - 1.2}, RELEASE - 1.2),
        ({"turned_at": RELEASE - 0.9}, RELEASE - 0.9),
        # What is shorter than the 0.3 s that show a hold changes nothing before them.
        ({"seconds": 1.0}, RELEASE - 0.8),
    ],
)
def test_a_hold_counts_back_to_its_last_movement_for_two_seconds(change, begin):
    motion = spatial_motion(_long_hold(**change), None, CaptureFrame("+z", "+x"))
    held = find_fall(motion, G, "drop.csv")
    assert motion.time[held.start] == pytest.approx(begin, abs=0.03)
    assert RELEASE - 0.06 < motion.time[held.stop] <= RELEASE + 0.03


def test_a_level_release_has_exactly_no_pitch():
    """A hold that defines level starts a drop at no pitch, not at the mean of another set of samples."""
    frame = CaptureFrame("+z", "+x")
    motion = spatial_motion(_long_hold(noise_deg=0.2), None, frame)
    held = find_fall(motion, G, "drop.csv")
    planar = planar_motion(motion, np.zeros(3), held_level(motion, held))
    states = [fit_flight(planar, FEET, held, G, "drop.csv", level)[0].state for level in (True, False)]
    assert (states[0][2], states[0][5]) == (0.0, 0.0)
    # Without that word it is the mean of the fall's samples too: 0.2 deg over the root of 400 samples.
    assert 0 < abs(states[1][2]) < np.radians(0.04)


def test_refusals_name_the_cause():
    recording = _recording(FRAME)
    with pytest.raises(LogError, match="no rigid body 'drone'; found F450"):
        spatial_motion(recording, "drone", FRAME)
    with pytest.raises(LogError, match="nothing falls in this log"):
        find_fall(spatial_motion(recording, None, CaptureFrame("+x", "+y")), G, "drop.csv")
    motion = spatial_motion(recording, None, FRAME)
    held = find_fall(motion, G, "drop.csv")
    for height, sentence in (
        (0.5, "below the surface before the drop"),
        (-0.5, "no foot reaches the surface"),
    ):
        planar = planar_motion(motion, np.array([0.0, 0.0, height]), np.eye(3))
        with pytest.raises(LogError, match=sentence):
            fit_flight(planar, FEET, held, G, "drop.csv")
