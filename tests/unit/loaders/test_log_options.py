"""Campaigns hand options to loaders: every option of every format; a trial wins; a typo is named."""

import warnings

import numpy as np
import pytest

from sysid.campaign import GearCampaign, read_campaign
from sysid.campaign import file as campaign_file
from sysid.campaign.logs import BenchLogOptions, CaptureLogOptions, SecondLog
from sysid.campaign.motor import StaticLog
from sysid.errors import CampaignError, LogError, SysidError, SysidWarning
from sysid.gear.drops import prepare_drops
from sysid.loaders import LogFormat, formats, registry
from sysid.loaders.options import DECLARED
from sysid.motor.bench_logs import check_options, read_log
from sysid.recording import Channel, Provenance, Recording
from sysid.trials.bench_log import on_one_clock
from sysid.workflows.inspect import print_formats

MOTOR = """
kind = "motor"
name = "a"
[command]
unit = "us"
minimum = 1000
maximum = 2000
[log]
{log}
[[trials]]
name = "t"
log = "log.csv"
direction = "forward"
{trial}
"""
GEAR = """
kind = "gear"
name = "a"
[vehicle]
body_mass = "1 kg"
body_inertia = "0.01 kg·m²"
foot_dx = "0.1 m"
foot_dz = "0.1 m"
[capture]
{capture}
[surface]
point = ["0 m", "0 m", "0 m"]
[[trials]]
name = "t"
log = "log.csv"
slope = "10 deg"
{trial}
"""


def campaign(tmp_path, text):
    path = tmp_path / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return read_campaign(path), path


def test_every_option_of_every_format_can_be_said():
    bench, capture = set(BenchLogOptions.model_fields), set(CaptureLogOptions.model_fields)
    for name, log_format in formats().items():
        left = set(log_format.options)
        assert left <= bench or left <= capture, (name, left - bench, left - capture)
        assert set(log_format.help) == left


def test_formats_says_what_every_option_means(capsys):
    print_formats()
    shown = " ".join(capsys.readouterr().out.split())
    assert all(f" {name} {option.help}" in shown for name, option in DECLARED.items())
    assert "quaternion_order Order of q0 to q3. One of wxyz, xyzw." in shown


def test_an_option_of_a_plug_in_format_can_be_stated(tmp_path, monkeypatch):
    known = formats()
    wand = LogFormat("wand", "from another package", lambda source: 0, lambda source, *, wand_length="": None)
    monkeypatch.setattr(registry, "formats", lambda: {**known, "wand": wand})
    stated, _ = campaign(tmp_path, GEAR.format(capture="wand_length = '5 cm'\nrigid_body = 'a'", trial=""))
    options = {"wand_length": "5 cm", "rigid_body": "a"}
    assert stated.capture.loader_options() == options
    again = CaptureLogOptions.model_validate_json(stated.capture.model_dump_json(include=set(options)))
    assert again.loader_options() == options
    with pytest.raises(CampaignError, match=r"unknown key capture\.wnd_length"):
        campaign(tmp_path, GEAR.format(capture="wnd_length = '5 cm'", trial=""))


def test_another_kind_of_campaign_can_be_registered(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign_file, "_KINDS", dict(campaign_file._KINDS))
    campaign_file.register_campaign("wing", GearCampaign)
    text = GEAR.format(capture="", trial="").replace('"gear"', '"wing"')
    with pytest.raises(CampaignError, match="expected 'gear'"):  # validated by the class that is given
        campaign(tmp_path, text)
    with pytest.raises(CampaignError, match=r"expected 'wing' or .*'gear'"):
        campaign(tmp_path, text.replace('"wing"', '"sail"'))


@pytest.mark.parametrize(("text", "log", "trial", "sentence"), [
    (MOTOR, "", "log_options = { rat = '5 kHz' }",
     "unknown key trials['t'].log_options.rat; nearest known key is 'rate'"),
    (MOTOR, "", "second_log = { log = 'b.csv', pulses_per_rev = 2 }",
     "unknown key trials['t'].second_log.pulses_per_rev; nearest known key is 'pulses_per_revolution'"),
    (MOTOR, "", "second_log = { rate = '5 Hz' }", "trials['t'].second_log.log is missing"),
    (MOTOR, "transform = { dq = '1 mm' }", "",
     "unknown key log.transform.dq; known keys are dx, dy, dz, rx, ry, rz"),
    (MOTOR, "transform = { dx = '1 N' }", "", "log.transform.dx: unit 'N' is not a 'm'"),
    (MOTOR, "units = { thrust = 'gff' }", "", "log.units.thrust: unknown unit 'gff'"),
    (MOTOR, "pulses_per_revolution = 0", "", "log.pulses_per_revolution: "),
    (MOTOR, "columns = 7", "", "log.columns: expected { speed = "),
    (MOTOR, "tare = '1 N'", "", "log.tare: unit 'N' is not a 's'"),
    (GEAR, "bodys = { a = ['b'] }", "", "unknown key capture.bodys; nearest known key is 'bodies'"),
    (GEAR, "bodies = { a = 'b' }", "", "capture.bodies.a: expected a list"),
    (GEAR, "", "log_options = { lenght_unit = 'mm' }",
     "unknown key trials['t'].log_options.lenght_unit; nearest known key is 'length_unit'"),
    (GEAR, "", "rigid_body = 'a'\nlog_options = { rigid_body = 'b' }",
     "trial 't': rigid_body is given twice"),
    (GEAR, "clock = 'later'", "", "capture.clock: "),
])  # fmt: skip
def test_a_typo_is_one_sentence(tmp_path, text, log, trial, sentence):
    with pytest.raises(CampaignError) as caught:
        campaign(tmp_path, text.format(log=log, capture=log, trial=trial))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "tuple[" not in str(caught.value)


CELL = "Time (s),Command (us),Speed,Fz (N)\n" + "".join(f"{i * 0.01:.2f},1000,{i},{i}\n" for i in range(9))


def first_log(tmp_path, log, trial=""):
    """Return the recording of the first trial of a motor campaign with this [log] and these trial keys."""
    stated, path = campaign(tmp_path, MOTOR.format(log=log, trial=trial))
    return read_log(stated, path, stated.trials[0])[0]


def test_a_trial_wins_over_the_campaign_and_must_fit_its_format(tmp_path):
    (tmp_path / "log.csv").write_text(CELL, encoding="utf-8")
    # The campaign says datasets and static, which this log's format does not take: not meant for it.
    wide = "speed_unit = 'rpm'\ndatasets = { speed = 'n' }\nstatic = true"
    for trial, factor in (("", np.pi / 30), ("log_options = { units = { speed = 'deg/s' } }", np.pi / 180)):
        np.testing.assert_allclose(first_log(tmp_path, wide, trial)["speed"].values, np.arange(9) * factor)
    with pytest.raises(LogError, match='format load-cell-csv has no option "static"'):
        first_log(tmp_path, wide, "log_options = { static = true }")
    # A unit that contradicts the log is taken back for one trial by another table of the same name.
    with pytest.raises(SysidError, match='units names "Fy"'):
        first_log(tmp_path, "units = { Fy = 'N' }\nspeed_unit = 'rpm'")
    other = first_log(tmp_path, "units = { Fy = 'N' }", "log_options = { units = { speed = 'rpm' } }")
    assert "thrust" in other.channels


def test_an_option_that_no_log_takes_is_said(tmp_path):
    (tmp_path / "log.csv").write_text(CELL, encoding="utf-8")
    stated, path = campaign(tmp_path, MOTOR.format(log="speed_unit = 'rpm'\ntare = '1 s'", trial=""))
    with pytest.warns(
        SysidWarning, match=r"log\.tare has no effect: .* load-cell-csv, and it is for ati-text, "
    ):
        check_options(stated, path)
    stated, path = campaign(tmp_path, MOTOR.format(log="speed_unit = 'rpm'\nrate = '100 Hz'", trial=""))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_options(stated, path)
    stated, path = campaign(tmp_path, GEAR.format(capture="rigid_body = 'c'\nangles = 'XYZ'", trial=""))
    with pytest.warns(SysidWarning, match=r"capture\.angles has no effect"), pytest.raises(SysidError):
        prepare_drops(stated, path)


def test_columns_of_other_names(tmp_path):
    text = CELL.replace("Speed", "n [rpm]").replace("Fz", "F").replace("Time (s)", "Zeit (s)")
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    log = "format = 'load-cell-csv'\ncolumns = "
    recording = first_log(tmp_path, log + "{ time = 'Zeit', speed = 'n [rpm]', Fz = 4 }")
    # A column keeps the unit that stands beside its old name.
    np.testing.assert_allclose(recording["speed"].values, np.arange(9) * np.pi / 30)
    np.testing.assert_array_equal(recording["thrust"].values, np.arange(9))
    for columns, sentence in [
        ("{ speed = 'm' }", "speed is 'm', which is neither a column nor its number from 1"),
        ("{ speed = 9 }", "speed is 9"),
        ("{ speed = 0 }", "speed is 0"),
    ]:
        with pytest.raises(LogError, match=f"columns says that {sentence}"):
            first_log(tmp_path, log + columns)
    # A list names all columns of a log without header.
    (tmp_path / "log.csv").write_text("\n".join(CELL.splitlines()[1:]) + "\n", encoding="utf-8")
    recording = first_log(tmp_path, log + "['Time (s)', 'Command (us)', 'Speed (rpm)', 'Fz (N)']")
    assert set(recording.channels) == {"command", "speed", "thrust"}


def test_a_drop_may_name_another_body_than_the_campaign(tmp_path):
    lines = ["Objects", "100", ",,Global Angle a:a,,,,,,Global Angle b:b,,,,,",
             "Frame,Sub Frame" + ",RX,RY,RZ,TX,TY,TZ" * 2, "," + ",,,,mm,mm,mm" * 2]  # fmt: skip
    lines += [f"{i},0" + ",0,0,0,1,2,3" * 2 for i in range(30)]
    (tmp_path / "log.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    for trial, sentence in [("rigid_body = 'b'", "nothing falls|fall|release"), ("", 'no rigid body "c"')]:
        stated, path = campaign(tmp_path, GEAR.format(capture="rigid_body = 'c'", trial=trial))
        with pytest.raises(SysidError, match=sentence) as caught:
            prepare_drops(stated, path)
        assert ("no rigid body" in str(caught.value)) == (trial == "")


def test_a_second_log_without_a_common_event_is_refused(tmp_path):
    (tmp_path / "log.csv").write_text(CELL.replace("Speed", "Speed (rad/s)") * 1, encoding="utf-8")
    random = np.random.default_rng(0)
    rows = "".join(f"{i * 0.01:.2f},{v:.3f}\n" for i, v in enumerate(random.normal(size=200)))
    (tmp_path / "b.csv").write_text("Time (s),Speed (rad/s)\n" + rows, encoding="utf-8")
    stated, path = campaign(tmp_path, MOTOR.format(log="", trial="second_log = { log = 'b.csv' }"))
    with pytest.raises(LogError, match=r"b\.csv: (cannot be aligned|speed has 9 samples, too few)"):
        read_log(stated, path, stated.trials[0])
    missing = StaticLog(log="log.csv", second_log=SecondLog(log="none.csv"))
    with pytest.raises(CampaignError, match=r"log 'none.csv' does not exist"):
        read_log(stated, path, missing)


def test_channels_on_one_clock():
    fine, coarse = np.arange(0, 1, 1e-3), 0.2 + np.arange(0, 0.6, 0.01)
    values = np.sin(coarse)
    values[20:30] = np.nan
    channels = {
        "torque": Channel("torque", "N·m", fine, fine),
        "command": Channel("command", "us", coarse, np.where(coarse < 0.5, 1000.0, 1500.0)),
        "speed": Channel("speed", "rad/s", coarse, values),
    }
    log = Recording("load-cell", channels, Provenance("a", "", "a"))
    stated = on_one_clock(log, ("command", "speed", "torque"), ("torque",))
    time = stated["torque"].time
    # Rows while the other logger ran, and to the end of its last row's step.
    assert time[0] == pytest.approx(0.2)
    assert time[-1] == pytest.approx(0.8, abs=1.1e-3)
    np.testing.assert_array_equal(stated["command"].values, np.where(time < 0.5 - 1e-9, 1000.0, 1500.0))
    known = stated["speed"].valid
    # Linear between samples 10 ms apart of a sine: an eighth of the step's square.
    np.testing.assert_allclose(stated["speed"].values[known], np.sin(time[known]), atol=1.3e-5)
    # Ten samples lost are 110 ms between two known ones: nothing is filled in there.
    lost = time[~known & (time < 0.75)]
    assert (lost[0], lost[-1]) == (pytest.approx(0.391, abs=1e-6), pytest.approx(0.499, abs=1.1e-3))
    assert any("taken linear between them" in note for note in stated.provenance.sentences)
    assert on_one_clock(stated, ("command", "speed", "torque"), ("torque",)) is stated
