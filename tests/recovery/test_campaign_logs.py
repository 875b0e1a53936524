"""One drop or one motor test in the files of other instruments: the campaign says what the files do not."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fakes.motor_bench import problem_of, score_values
from sysid.campaign import read_campaign
from sysid.fit.store import read_fit
from sysid.gear.drops import prepare_drops
from sysid.loaders import load
from sysid.motor.known_values import prepare_bench
from sysid.motor.model import PARAMETERS
from sysid.motor.story import MotorStory
from sysid.synthetic import synthesize_gear
from sysid.synthetic.motor import TRIALS, TRUE_MOTOR, synthesize_motor
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions

BODY = "F450"


@pytest.fixture(scope="module")
def drops(tmp_path_factory):
    """Drops as Motive exports them, without noise, and what a campaign makes of the first."""
    folder = tmp_path_factory.mktemp("capture") / "drops"
    synthesize_gear(folder, seed=5, noise_position=0.0, noise_angle=0.0, occlusions=False, wobble=0.0)
    path = folder / "campaign.toml"
    campaign = read_campaign(path, "gear")
    return path, campaign, prepare_drops(campaign, path)


# Corners of a body [m]: their centre is its origin, and no three of them are alike.
CORNERS = np.array([[0.15, 0.02, 0.1], [-0.12, 0.03, 0.13], [-0.16, -0.02, -0.11], [0.13, -0.03, -0.12]])


def changed(drops, log, capture, trial=""):
    """Return the first drop of the campaign with its log in another file and other words for it."""
    path, campaign, _ = drops
    text = path.read_text(encoding="utf-8")
    head = text[: text.index("[[trials]]")]
    first = text[text.index("[[trials]]") :].split("\n[[trials]]")[0]
    offset = next(line for line in head.splitlines() if line.startswith("centre_of_mass_offset"))
    for old, new in capture.items():
        assert old in (BODY, "offset")
        head = head.replace(f'rigid_body = "{BODY}"' if old == BODY else offset, new)
    first = first.replace(f'log = "{campaign.trials[0].log}"', f'log = "{log}"')
    other = path.with_name(f"{Path(log).stem}.toml")
    other.write_text(head + first + trial, encoding="utf-8")
    again = read_campaign(other, "gear")
    return prepare_drops(again, other)[0]


def same_drop(found, wanted, position=1e-5, speed=2e-3):
    assert found.touchdown == pytest.approx(wanted.touchdown, abs=1e-4)
    assert found.impact_speed == pytest.approx(wanted.impact_speed, abs=2e-3)
    got, want = found.target.measured, wanted.target.measured
    assert got.shape == want.shape
    np.testing.assert_allclose(got[:, [0, 1]], want[:, [0, 1]], atol=position)
    np.testing.assert_allclose(got[:, [2, 3]], want[:, [2, 3]], atol=speed)
    np.testing.assert_allclose(got[:, 4], want[:, 4], atol=1e-4)


def seen(drops):
    """Return rate, first frame number, positions, orientations and corners (n, 4, 3) of the first drop."""
    path, campaign, _ = drops
    log = load(path.with_name(campaign.trials[0].log))
    place, turn = log[f"{BODY}/position"], log[f"{BODY}/orientation"].values
    rotation = Rotation.from_quat(np.roll(turn, -1, axis=1))
    points = place.values[:, None] + np.einsum("nij,kj->nki", rotation.as_matrix(), CORNERS)
    return place.rate, round(place.time[0] * place.rate), place.values, rotation, points


def marker_offset(drops, rotation):
    """Return the centre of mass in the axes of a body of markers: those of the capture in the first frame."""
    offset = rotation[0].apply(drops[1].capture.centre_of_mass_offset)
    return "centre_of_mass_offset = [" + ", ".join(f'"{1e3 * x:.9f} mm"' for x in offset) + "]"


def test_drop_as_markers_in_a_c3d(drops):
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d comes with the logs extra")
    rate, first, _, rotation, points = seen(drops)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["p1", "p2", "p3", "p4"]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    data = np.ones((4, 4, len(points)))
    data[:3] = 1e3 * points.transpose(2, 1, 0)
    file["data"]["points"] = data
    # ezc3d writes no other first frame than the header's own.
    file["header"]["points"]["first_frame"] = first
    file["header"]["points"]["last_frame"] = first + len(points) - 1
    file.write(str(drops[0].with_name("markers.c3d")))
    begin = load(drops[0].with_name("markers.c3d"))["p1/position"].time[0]
    bodies = f'rigid_body = "{BODY}"\nbodies = {{ {BODY} = ["p1", "p2", "p3", "p4"] }}'
    found = changed(drops, "markers.c3d", {BODY: bodies, "offset": marker_offset(drops, rotation)})
    wanted = drops[2][0]
    # On the file's own clock.
    assert found.touchdown - begin == pytest.approx(wanted.touchdown - first / rate, abs=1e-4)
    # C3D keeps single precision: 1e-7 of 1 m, and 1e-6 rad on a body of 0.3 m.
    shifted = found.target.measured
    np.testing.assert_allclose(shifted[:, :2], wanted.target.measured[:, :2], atol=1e-5)
    np.testing.assert_allclose(shifted[:, 4], wanted.target.measured[:, 4], atol=1e-4)
    assert any(f"pose of {BODY} from 4 markers" in note for note in found.provenance["notes"])


def test_drop_as_vicon_markers_and_as_a_tracker_object(drops):
    rate, first, place, rotation, points = seen(drops)
    names = "," + "".join(f",{BODY}:{i},," for i in range(4))
    lines = ["Trajectories", f"{rate:.0f}", names, "Frame,Sub Frame" + ",X,Y,Z" * 4, "," + ",mm" * 12]
    for i, row in enumerate(points):
        cells = [str(first + i), "0", *(f"{1e3 * x:.6f}" for x in row.ravel())]
        if i == 3:  # one corner is hidden: three are enough
            cells[2:5] = ["", "", ""]
        lines.append(",".join(cells))
    drops[0].with_name("nexus.csv").write_text("\r\n".join([*lines, ""]), encoding="utf-8", newline="")
    found = changed(drops, "nexus.csv", {"offset": marker_offset(drops, rotation)})
    same_drop(found, drops[2][0])

    lines = [
        "Objects", f"{rate:.0f}", f",,Global Angle {BODY}:{BODY},,,,,", "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ",
        ",,deg,deg,deg,mm,mm,mm",
    ]  # fmt: skip
    angles = rotation.as_euler("XYZ", degrees=True)
    for i, (turn, at) in enumerate(zip(angles, 1e3 * place, strict=True)):
        lines.append(",".join([str(first + i), "0", *(f"{x:.9f}" for x in (*turn, *at))]))
    drops[0].with_name("tracker.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    own = '\nlog_options = { angles = "XYZ", format = "vicon-csv" }\n'
    same_drop(changed(drops, "tracker.csv", {}, own), drops[2][0])


def test_drop_as_a_table_of_other_words(drops):
    _, _, place, rotation, _ = seen(drops)
    time = load(drops[0].with_name(drops[1].trials[0].log))[f"{BODY}/position"].time
    rows = np.column_stack([1e3 * time, 1e3 * place, rotation.as_quat()])
    text = "clock;left;up;ahead;a;b;c;d\n" + "".join(";".join(f"{x:.9f}" for x in row) + "\n" for row in rows)
    drops[0].with_name("table.csv").write_text(text, encoding="utf-8")
    own = (
        '\n[trials.log_options]\nformat = "pose-table"\nlength_unit = "mm"\nunits = { t = "ms" }\n'
        'columns = { t = "clock", x = "left", y = "up", z = 4, qx = "a", qy = "b", qz = "c", qw = "d" }\n'
    )
    same_drop(changed(drops, "table.csv", {}, own), drops[2][0])


TRUTH = {**PARAMETERS.nominal, **TRUE_MOTOR}
LBF, LBF_IN = 4.4482216152605, 0.1129848290276167
# One volt of gauge k is so many lbf or lbf-in: a cell whose gauges see one axis each.
GAIN = np.array([3.0, 3.0, 3.0, 0.5, 0.5, 0.5])
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
CAL = (
    '<FTSensor Serial="FT00007" BodyStyle="Mini40"><Calibration PartNumber="X" ForceUnits="lbf" '
    'TorqueUnits="lbf-in">'
    + "".join(
        f'<UserAxis Name="{axis}" values="{" ".join(str(g * (i == k)) for k in range(6))}" max="60"/>'
        for i, (axis, g) in enumerate(zip(AXES, GAIN, strict=True))
    )
    + "</Calibration></FTSensor>"
)


@pytest.fixture(scope="module")
def cell_and_tachometer(tmp_path_factory):
    """A campaign whose trial is an ATI log of gauge voltages and a tachometer's file, 7.3 s apart."""
    folder = tmp_path_factory.mktemp("bench") / "motor"
    synthesize_motor(folder, seed=4, trials=TRIALS[:1])
    log = load(folder / "forward-1.csv")
    time, speed = log["speed"].time, log["speed"].values
    # The cell is mounted upside down, so what it feels is turned about x; its torque is about a point on z.
    load_cell = np.zeros((time.size, 6))
    load_cell[:, 2], load_cell[:, 5] = -log["thrust"].values, -log["torque"].values
    volts = load_cell / np.repeat([LBF, LBF_IN], 3) / GAIN + 0.25
    rows = "".join(",".join(f"{v:.7f}" for v in row) + "\n" for row in volts)
    text = (
        "First line indicates sampling freq [Hz], samples per channel,,,\nFx,Fy,Fz,Tx,Ty,Tz\n10000,75,0,,,\n"
    )
    (folder / "cell.txt").write_text(text + rows, encoding="utf-8")
    (folder / "FT00007.cal").write_text(CAL, encoding="utf-8")
    # Six marks: one edge per period of 6 marks, read by a second computer from 0.2 s later on.
    marks = 6 * np.cumsum(np.abs(speed)) * 1e-4 / (2 * np.pi)
    pulses = (marks % 1.0 < 0.5).astype(int)
    own = np.arange(2000, time.size)
    lines = [f"{1e-4 * i - 7.3:.4f},{log['command'].values[i]:.0f},{5 * pulses[i]}" for i in own]
    header = "Time (s),Command (us),Tachometer (V)"
    (folder / "tach.csv").write_text("\n".join([header, *lines, ""]), encoding="utf-8")
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    start = float(text.split('start = "')[1].split(" s")[0]) - time[0]
    text = text.replace('log = "forward-1.csv"', 'log = "cell.txt"')
    text = text[: text.index('start = "')] + (
        f'start = "{start:.4f} s"\n'
        '[trials.log_options]\ncalibration = "FT00007.cal"\ntare = "0.4 s"\ntransform = { rx = "180 deg" }\n'
        '[trials.second_log]\nlog = "tach.csv"\nalign_by = "thrust:speed"\npulses_per_revolution = 6\n'
    )
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_cell_and_tachometer_are_one_trial(cell_and_tachometer):
    path = cell_and_tachometer
    campaign = read_campaign(path, "motor")
    bench = prepare_bench(campaign, path)
    record = bench.trials[0].provenance
    second = record["second_log"]
    # The cell's clock starts at 0 and the tachometer's at -7.3 s + 0.2 s: the cell's is 7.3 s ahead.
    # Its pulses are 2 to 5 ms apart, each a mean over that time: the steps place them to a quarter of one.
    assert second["offset"] == pytest.approx(7.3, abs=5e-4)
    assert second["correlation"] > 0.8
    assert second["confidence"] > 0.1
    assert second["aligned"] == "speed with thrust"
    assert record["device"] == "ATI Mini40 FT00007 X"
    hashes = MotorStory(problem_of(campaign, bench)).hashes
    assert len(hashes[bench.trials[0].entry.name].split()) == 2
    assert any("tare" in note for note in record["notes"])
    assert any("speed from" in note for note in second["notes"])
    scored = score_values(campaign, bench, TRUTH)
    # Torque as in one file of one clock (0.008 there), and a clock 0.3 ms off at steps of 40 mN·m in 10 ms:
    # 0.7 % more. An edge is known to one sample of 0.1 ms: 0.016 rad of phase at 550 rad/s, which behind the
    # 60 Hz of the filter is 2 to 3 rad/s of a deviation of 170.
    assert np.all(scored[:, 0] < 0.013)
    assert np.all(scored[:, 1] < 0.02)
    folder = path.with_name("fit")
    options = FitOptions(
        folder, population=8, runs=1, max_generations=1, finish="none", quiet=True, trust=False
    )
    fit_motor(path, options)
    stored = read_fit(folder).provenance["logs"]["forward-1"]["second_log"]
    assert stored["log"] == "tach.csv"
    assert {key: stored[key] for key in ("offset", "confidence")} == pytest.approx(
        {key: second[key] for key in ("offset", "confidence")}
    )
