"""Thrust-stand logs of a motor with a faulty column: what is left out, what is said."""

from pathlib import Path

import numpy as np
import pytest

from sysid.campaign import read_campaign
from sysid.errors import CampaignError, LogError, SysidWarning
from sysid.motor.inertia import spike_inertia
from sysid.motor.known_values import prepare_bench
from sysid.motor.model import PARAMETERS
from sysid.trials.bench_log import CommandSteps, rows_at_rest, standing_command

pytestmark = pytest.mark.filterwarnings("ignore:no Kv in the campaign", "ignore:no thrust")

LEVELS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.0)
COLUMNS = "Time (s),ESC signal,Torque (N·m),Thrust (N),Voltage (V),Motor Optical Speed (rad/s)\n"


def _write(
    folder: Path, *, volts=None, jitter: float = 0.0, kv: str = "", extra: str = "", command: str = ""
) -> Path:
    """Write a staircase of 2 s per level in rows of 20 ms, and its campaign.

    `volts` makes the voltage of the row numbers; the motor's own sags from 16 to 14 V.
    """
    time = np.arange(0.0, 2.0 * len(LEVELS), 0.02)
    level = np.asarray(LEVELS)[(time / 2.0).astype(int)]
    since = np.mod(time, 2.0)
    before = np.concatenate([[0.0], LEVELS])[(time / 2.0).astype(int)]
    share = level + (before - level) * np.exp(-since / 0.05)
    supply = 16.0 - 2.5 * level
    speed = np.where((level == 0) & (since > 0.3) | (time < 2), 0.0, 900.0 * share * supply / 16.0)
    torque, thrust = 3e-3 + 1.6e-7 * speed**2, 0.2 + 1e-5 * speed**2
    shown = supply if volts is None else volts(np.arange(time.size), supply)
    logged = 1000.0 + 1000.0 * level + jitter * np.where(np.arange(time.size) % 2, 1.0, -1.0) * (level == 0)
    table = np.column_stack([time, logged, torque, thrust, shown, speed])
    rows = "\n".join(",".join(f"{value:.8g}" for value in row) for row in table)
    (folder / "log.csv").write_text(COLUMNS + rows + "\n", encoding="utf-8", newline="\n")
    path = folder / "campaign.toml"
    command = command or 'unit = "us"\nminimum = 1000\nmaximum = 2000'
    path.write_text(
        f'kind = "motor"\nname = "faults"\n[motor]\n{kv}\n'
        f'[command]\n{command}\n[log]\ncommand_unit = "us"\n{extra}\n'
        '[[trials]]\nname = "steps"\nlog = "log.csv"\ndirection = "forward"\n',
        encoding="utf-8",
        newline="\n",
    )
    return path


def _bench(path: Path):
    return prepare_bench(read_campaign(path, "motor"), path)


def test_voltage_of_an_unconnected_probe_is_left_out(tmp_path: Path) -> None:
    bench = _bench(_write(tmp_path, volts=lambda i, v: 0.0 * v))
    (trial,) = bench.trials
    assert "voltage" not in trial.log.channels
    assert "no-voltage" in {note.code for note in trial.log.notes}
    assert trial.simulated.supply is None


def test_single_zeros_of_the_voltage_do_not_bend_the_no_load_line(tmp_path: Path) -> None:
    whole = _bench(_write(tmp_path)).curves
    holed = _bench(_write(tmp_path, volts=lambda i, v: np.where(i % 5 == 0, 0.0, v))).curves
    # Rows that are left out change a mean of constant volts by nothing; counted as 0 V they took 20 %.
    np.testing.assert_allclose(holed.ties["forward"].columns, whole.ties["forward"].columns, rtol=1e-6)
    assert holed.reference_voltage == pytest.approx(whole.reference_voltage, rel=1e-2)


def test_zeros_of_the_voltage_of_averaged_points_are_no_volts(tmp_path: Path) -> None:
    path = _write(tmp_path, extra='[curves]\nstatic = [{ log = "static.csv" }]')
    u = np.array([0.0, 0.2, 0.4, 0.6, 0.8])
    speed = 900.0 * u
    rows = [
        f"{2 * i},{1000 + 1000 * c:g},{1.6e-7 * s * s:.8g},{1e-5 * s * s:.8g},0,{s:g}"
        for i, (c, s) in enumerate(zip(u, speed, strict=True))
    ]
    (tmp_path / "static.csv").write_text(COLUMNS + "\n".join(rows) + "\n", encoding="utf-8", newline="\n")
    # Unknown volts count as the reference: the columns are u itself.
    np.testing.assert_allclose(_bench(path).curves.ties["forward"].columns[:, 0], u[1:], rtol=1e-9)


@pytest.mark.parametrize("kv", ['"960"', "960", '"9.6e2"'])
def test_kv_without_unit_is_told_the_unit_of_the_shops(tmp_path: Path, kv: str) -> None:
    path = _write(tmp_path, kv=f"kv = {kv}")
    with pytest.raises(CampaignError, match=r'has no unit; write kv = "9[0-9.e]+ rpm/V", as motors are sold'):
        read_campaign(path, "motor")


def test_jitter_of_the_neutral_keeps_the_rows_at_rest(tmp_path: Path) -> None:
    (calm,) = _bench(_write(tmp_path)).trials
    (shaken,) = _bench(_write(tmp_path, jitter=1.0)).trials
    assert shaken.log.tares["torque"].rows == calm.log.tares["torque"].rows > 90
    np.testing.assert_array_equal(shaken.log.steps.level, calm.log.steps.level)


def test_torque_spikes_pass_the_filter_of_the_campaign(tmp_path: Path) -> None:
    # 50 rows a second bear a stop band from 4 Hz on; the default's 100 Hz they do not.
    path = _write(tmp_path, extra='[filter]\nstop_edge = "4 Hz"')
    bench = _bench(path)
    (trial,) = bench.trials
    assert trial.log.fast
    parameters = {**PARAMETERS.nominal, **bench.curves.parameters}
    inertia = spike_inertia(read_campaign(path, "motor"), [trial.log], parameters)
    assert inertia.steps["up"] >= 2
    assert np.isfinite(inertia.value["up"])


def test_log_without_torque_is_told_where_the_curves_come_from(tmp_path: Path) -> None:
    path = _write(tmp_path)
    log = tmp_path / "log.csv"
    rows = [line.split(",") for line in log.read_text(encoding="utf-8").splitlines()]
    text = "\n".join(",".join(row[:2] + row[3:]) for row in rows)
    log.write_text(text + "\n", encoding="utf-8", newline="\n")
    words = (
        r"no torque; record it, or set cost\.weights\.torque = 0 and name a log with torque in curves\.static"
    )
    with pytest.raises(LogError, match=words):
        _bench(path)


def test_rotor_that_stands_under_a_command_is_told(tmp_path: Path) -> None:
    # Pulses of 1000 to 2000 µs read as numbers of 0 to 2047: rest is u = 0.49.
    pulses = 'unit = "us"\nminimum = 0\nmaximum = 2047'
    words = r"the rotor stands under command 1000 \(u = 0\.49\); correct command\.unit or command\.neutral"
    with pytest.warns(SysidWarning, match=words):
        _bench(_write(tmp_path, command=pulses))


def _made(*holds: tuple[float, float]) -> float | None:
    """The command that counts as standing among holds of 1 s, each (u, speed [rad/s])."""
    time = np.arange(0.0, len(holds), 0.01)
    speed = np.repeat([turning for _, turning in holds], 100).astype(float)
    steps = CommandSteps(np.arange(float(len(holds))), np.array([u for u, _ in holds]))
    return standing_command(time, speed, steps, (0.0, float(len(holds))))


def test_only_a_wrong_unit_or_neutral_explains_a_standing_rotor() -> None:
    # A neutral that is off: it stands under more than it turns under. 0.2 rad/s is noise.
    assert _made((-1.0, 0.2), (0.0, 300.0), (0.5, 600.0)) == -1.0
    # A unit that is off: it stands, and the log never commands less.
    assert _made((0.49, 0.0), (0.6, 300.0)) == 0.49
    # A throttle that begins above 12 %, idling, a stair in steps of 5 %.
    assert _made((0.0, 0.0), (0.12, 0.0), (0.5, 300.0)) is None
    assert _made((0.0, 0.0), (0.05, 0.0), (0.10, 0.0), (0.15, 0.0), (0.2, 200.0)) is None
    assert _made((0.0, 0.0), (0.0, 0.0)) is None


def test_a_late_start_and_a_cut_are_not_standing() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    steps = CommandSteps(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.5, 0.6]))
    late = np.where(time > 1.7, 300.0, 0.0)
    assert standing_command(time, late, steps, (0.0, 4.0)) is None
    cut = np.where((time > 1.1) & (time < 1.5), 300.0, 0.0)
    assert standing_command(time, cut, steps, (0.0, 4.0)) is None


@pytest.mark.parametrize("noise", ["white", "low-passed", "none"])
def test_a_noisy_speed_at_rest_is_at_rest(noise):
    """10 kHz, ± 1.3 rad/s where nothing turns; the rotor runs from 1 to 2 s and coasts with 0.1 s."""
    random, time = np.random.default_rng(1), np.arange(0.0, 4.0, 1e-4)
    u = np.where((time >= 1) & (time < 2), 0.5, 0.0)
    speed = np.where(time < 2, 800 * (1 - np.exp(-np.maximum(time - 1, 0) / 0.1)), 0.0)
    speed = np.where(time >= 2, 800 * np.exp(-(time - 2) / 0.1), speed)
    white = random.normal(size=time.size)
    if noise == "white":
        speed = speed + 1.3 / 3 * white
    elif noise == "low-passed":  # over 2 ms
        slow = np.convolve(white, np.ones(20), "same")
        speed = speed + 1.3 / 3 * slow / slow.std()
    else:
        speed[np.abs(speed) < 0.5] = 0.0
    rest = rows_at_rest(time, u, speed)
    assert rest[time < 1].mean() > 0.99
    # 800 rad/s are below the noise after 0.6 to 0.8 s; sensors ring for 0.5 s more.
    assert not rest[(time >= 1) & (time < 3)].any()
    assert rest[time > 3.5].mean() > 0.99


def test_a_rotor_that_never_stood_has_no_row_at_rest():
    time = np.arange(0.0, 2.0, 1e-3)
    speed = 400 + np.random.default_rng(1).normal(size=time.size)
    assert not rows_at_rest(time, np.zeros(time.size), speed).any()
