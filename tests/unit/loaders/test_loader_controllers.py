"""Telemetry of an ESC32 and logs of the systemId deck, row by row by hand; one public run on two loggers."""

import json

import numpy as np
import pytest

from fakes.log_files import notes, refuses
from fakes.places import REAL
from sysid.errors import LogError, UnitError
from sysid.loaders import detect, load
from sysid.workflows.inspect import SecondFile, convert_file, inspect_files

ESC32 = (
    "Timestamp,Amps,Batt. Volts,Motor Volts,RPM,Duty,Comm. Period,Bad Detects,ADC Window,Idle Time,State,"
    "Phase A Avg.,Phase B Avg.,Phase C Avg.,Composite Avg.,FET Step\n"
)
RAMP = "thrust[g],pwm,vbat[V],rpm1,rpm2,rpm3,rpm4\n"
TIMED = "time[ms],weight[g],pwm,vbat[V],rpm1,rpm2,rpm3,rpm4,v[V],i[A]\n"
RPM = np.pi / 30.0


def telemetry(stamps):
    rows = (f"2019-11-05 17:14:08:{ms:03},2.5,16,4,{60 * i},25,34,0,0,95.6,4,0,0,0,0,5\n" for i, ms in stamps)
    return ESC32 + "".join(rows)


def test_esc32_telemetry_has_duty_volts_amps_and_speed(write):
    path = write(telemetry(enumerate([947, 951, 951, 967])), "log.csv")
    assert detect(path) == "esc32-csv"
    log = load(path)
    np.testing.assert_allclose(log["speed"].time, [0, 0.004, 0.02], atol=1e-12)
    np.testing.assert_allclose(log["speed"].values, [0, 4 * np.pi, 6 * np.pi], rtol=1e-15)
    assert {name: (log[name].unit, log[name].values[0]) for name in log.channels if name != "speed"} == {
        "command": ("1", 0.25), "voltage": ("V", 16.0), "motor_voltage": ("V", 4.0), "current": ("A", 2.5),
    }  # fmt: skip
    assert "rows that repeat the time of the row before: 1" in notes(log)


def test_esc32_telemetry_gets_an_even_clock_from_a_declared_rate(write):
    late = np.random.default_rng(1).integers(0, 9, 90)
    path = write(telemetry((i, 10 * i + int(late[i])) for i in range(90)), "log.csv")
    log = load(path, rate="100 Hz")
    np.testing.assert_allclose(np.diff(log["speed"].time), 0.01, atol=1e-12)
    assert log["speed"].time.size == 90
    refuses(path, "rate = 50 makes the log 1.78 s long", rate=50)


def test_systemid_deck_of_four_motors_is_one_motor_in_steady_points(write):
    path = write(RAMP + "0,0,4.1,0,0,0,0\n40,32767.5,3.9,9000,10000,11000,10000\n", "log.csv")
    assert detect(path) == "bitcraze-csv"
    log = load(path)
    assert log.kind == "static-map"
    np.testing.assert_allclose(log["command"].values, [0, 0.5], rtol=1e-15)
    np.testing.assert_allclose(log["thrust"].values, [0, 0.010 * 9.80665], rtol=1e-15)  # 10 gf each
    np.testing.assert_allclose(log["speed"].values, [0, 10000 * RPM], rtol=1e-15)
    np.testing.assert_allclose(log["voltage"].values, [4.1, 3.9], rtol=1e-15)
    assert "motors that turn: 4; thrust, current and power are divided by it" in notes(log)
    running = load(path, rate="100 Hz")
    assert running.kind == "thrust-stand"
    np.testing.assert_allclose(running["thrust"].time, [0, 0.01], rtol=1e-15)


def test_systemid_deck_with_times_and_one_motor(write):
    path = write(TIMED + "100,0,0,4.1,0,0,0,0,4.0,0.1\n105,12,65535,3.9,20000,0,0,0,3.8,2.5\n", "log.csv")
    log = load(path)
    assert log.kind == "thrust-stand"
    np.testing.assert_allclose(log["thrust"].time, [0.1, 0.105], rtol=1e-12)
    np.testing.assert_allclose(log["thrust"].values, [0, 0.012 * 9.80665], rtol=1e-15)
    np.testing.assert_allclose(log["current"].values, [0.1, 2.5], rtol=1e-15)
    np.testing.assert_allclose(log["speed"].values, [0, 20000 * RPM], rtol=1e-15)


@pytest.mark.parametrize(("content", "error", "sentence"), [
    (RAMP + "1,0,4,0,0,0,0\n", LogError, "no motor turns in any row"),
    (RAMP.replace("[g]", "[V]") + "1,0,4,1,1,1,1\n", UnitError, 'column "thrust.V."'),
    (TIMED.replace("[ms]", "") + "1,1,0,4,1,1,1,1,4,1\n", UnitError, 'column "time" states no unit'),
])  # fmt: skip
def test_systemid_deck_refusals(write, content, error, sentence):
    refuses(write(content, "log.csv"), sentence, error)


STAND_LOGS = {
    # Rows that step back, by an independent count of the first column's falls.
    "Log_2019-11-05_171350.csv": 0, "Log_2019-11-07_174807.csv": 2, "Log_2019-11-09_181347.csv": 4,
}  # fmt: skip
ESC_TEST = REAL / "esc_test"
needs_logs = pytest.mark.skipif(not ESC_TEST.is_dir(), reason=f"the public logs are not in {ESC_TEST}")


@needs_logs
def test_every_public_log_is_shown(capsys):
    inspect_files(sorted(ESC_TEST.glob("*.csv")), as_json=True)
    reports = {report["path"].rsplit("/", 1)[-1]: report for report in json.loads(capsys.readouterr().out)}
    assert reports["f40_steps_5-2.csv"]["format"] == "esc32-csv"
    for name, late in STAND_LOGS.items():
        assert any(f"time goes back, left out: {late}" in said for said in reports[name]["notes"]) is (
            late > 0
        )


@needs_logs
def test_one_public_run_on_two_loggers_is_joined(tmp_path):
    """The duty of the controller takes the place of the stand's empty command; both give a speed."""
    stand, controller = ESC_TEST / "Log_2019-11-05_171350.csv", ESC_TEST / "f40_steps_5-2.csv"
    convert_file(stand, tmp_path / "run.h5", second=SecondFile(controller))
    run, alone = load(tmp_path / "run.h5"), load(controller)
    assert run["command"].unit == "1"
    assert run["command"].values.max() == 1.0
    offset = run["command"].time[0] - alone["command"].time[0]
    both = run["speed"].time[(run["speed"].time > 15) & (run["speed"].time < 120)]
    first, second = (
        np.interp(both, time, values)
        for time, values in (
            (run["speed"].time, run["speed"].values),
            (alone["speed"].time + offset, alone["speed"].values),
        )
    )
    # Two probes of one rotor: they agree within 2 % of the top speed in the median.
    assert np.median(np.abs(first - second)) < 0.02 * first.max()
