"""The command line as a user meets it: results, and refusals in one sentence with exit code 2."""

import ctypes
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from scipy.spatial.transform import Rotation

import sysid
from fakes.fits import full_fit
from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.cli.adapter import command
from sysid.fit.store import write_fit
from sysid.motor.bench_logs import campaign_range, read_log
from sysid.trust.documents import Judgement
from sysid.trust.use import NOT, judged_use


def edit(path, old, new, count=1):
    text = path.read_bytes().decode("utf-8-sig")
    assert old in text, f"{path.name} does not hold {old!r}"
    path.write_bytes(text.replace(old, new, count).encode())


def body_rows(path):
    """Return the lines of a Motive file and the index of its first data row."""
    lines = path.read_text(encoding="utf-8-sig").splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line.startswith("Frame,")) + 1
    return lines, first


def body_columns(lines, first):
    """Return the columns of the drone's rotation X, Y, Z, W; another rigid body stands before it."""
    names = lines[first - 4].rstrip("\r\n").split(",")
    start = names.index("F450")
    assert lines[first - 1].split(",")[start : start + 4] == ["X", "Y", "Z", "W"]
    return slice(start, start + 4)


SMALL = ("--no-trust", "--population", "16", "--runs", "2", "--max-generations", "2", "--quiet")
# Where a fit need not reach its optimum.
COARSE = ("--finish", "none", *SMALL)


def test_fit_gear_show_export_and_read_back(drops, run, tmp_path, refused):
    campaign = drops / "campaign.toml"
    code, out, err = run("fit-gear", campaign, *COARSE)
    assert (code, out) == (0, ""), err
    folder = Path("fits") / "synthetic-lf"
    assert {p.name for p in folder.iterdir()} == {"fit.h5", "fit.json", "summary.txt"}

    code, out, _ = run("show", folder)
    assert code == 0
    assert "k_h" in out
    code, out, _ = run("show", folder, "--json")
    shown = json.loads(out)
    assert len(shown["sets"]) == 2
    assert shown["sets"][0]["nrmse"] <= shown["sets"][1]["nrmse"]

    first = sysid.load_parameter_sets(folder / "fit.json")
    for suffix in ("json", "csv", "h5", "mat"):
        code, out, err = run("export", folder, "--out", f"sets.{suffix}")
        assert code == 0, err
        assert sysid.load_parameter_sets(f"sets.{suffix}") == first

    # A fit that exists is not overwritten unless asked.
    refused(["exists", "--force"], "fit-gear", campaign, *COARSE)
    refused(["exists already"], "export", folder, "--out", "sets.json")
    assert run("fit-gear", campaign, *COARSE, "--force")[0] == 0


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (("fit-geer", "x"), "no such command 'fit-geer', did you mean 'fit-gear'; sysid -h says more"),
        (("fit-gear",), "missing argument 'CAMPAIGN'; sysid fit-gear -h says more"),
        (("fit-gear", "x", "--run", "3"), "no such option: --run (Possible options: --resume, --runs,"),
        (("fit-gear", "x", "--algorithm", "nsga"), "'nsga' is not one of 'ga', 'matlab-ga', 'cmaes',"),
        (("fit-gear", "x", "--runs", "-3"), "--runs '-3': expected at least 1; sysid fit-gear -h says more"),
        (("fit-gear", "x", "--runs", "abc"), "--runs 'abc': expected a whole number; sysid fit-gear -h"),
        (("simulate", "x", "--slope"), "option '--slope' requires an argument; sysid simulate -h says more"),
        (("simulate", "x", "--slope", "20 deg", "--speed", "1"), "missing option '--motor'; sysid simulate"),
    ],
)  # fmt: skip
def test_a_wrong_command_line_is_refused_in_one_sentence(line, words, refused):
    assert refused(words, *line).count("\n") == 1


def test_ctrl_c_outlives_a_compiler_that_swallows_exceptions(monkeypatch, run):
    """In any command: an exception in a callback of LLVM is printed by ctypes and forgotten."""
    app = typer.Typer()
    swallowed = []
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    compiler = {"__name__": "llvmlite.binding.ffi", "callback": callback}
    exec("def optimize():\n    callback()", compiler)
    monkeypatch.setattr(sys, "unraisablehook", swallowed.append)

    @command(app, "wait", "sysid wait")
    def wait() -> None:
        compiler["optimize"]()
        time.sleep(5.0)
        raise AssertionError("not heard")

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr("sysid.cli.app", app)
    assert run() == (130, "", "stopped by the user\n")
    assert swallowed == []
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_in_the_making_of_a_class_stops_a_command(monkeypatch, run):
    """Python 3.11 wraps what `__set_name__` raises: pandas, being imported, was stopped by a RuntimeError."""
    app = typer.Typer()

    class Named:
        def __set_name__(self, owner: type, name: str) -> None:
            raise KeyboardInterrupt

    @command(app, "make", "sysid make")
    def make() -> None:
        type("Made", (), {"field": Named()})

    monkeypatch.setattr("sysid.cli.app", app)
    assert run() == (130, "", "stopped by the user\n")


def test_new_campaign_writes_a_template(tmp_path, run, refused):
    target = tmp_path / "mine.toml"
    code, out, _ = run("new-campaign", "motor", "--out", target)
    assert code == 0
    assert "fit-motor" in out
    assert "datasheet" in target.read_text(encoding="utf-8")
    refused(["exists already"], "new-campaign", "motor", "--out", target)


@pytest.mark.parametrize("verb", ["validate", "cross-validate"])
def test_a_flagged_prediction_ends_with_code_3(verb, monkeypatch, tmp_path, run):
    no_word = judged_use([], drawn=True)
    useless = no_word.model_copy(update={"word": NOT})
    for flagged, use in ((True, None), (False, useless), (False, None), (False, no_word)):
        for name in ("validate_fit", "cross_validate"):
            document = Judgement.model_construct(flagged=flagged, use=use)
            monkeypatch.setattr(f"sysid.workflows.predict.{name}", lambda *_, d=document, **__: d)
        more = (tmp_path / "campaign.toml",) if verb == "validate" else ()
        code, out, _ = run(verb, tmp_path, *more, "--json")
        assert code == (3 if flagged or use is useless else 0)
        assert json.loads(out)["flagged"] is flagged


def test_an_unfinished_fit_ends_with_code_3_where_that_is_asked_for(drops, run):
    """A run that its generations end is unfinished; without --strict its exit code is 0."""
    fit = ("fit-gear", drops, *COARSE, "--no-check")
    assert run(*fit)[0] == 0
    assert run(*fit, "--force", "--strict")[0] == 3


@pytest.mark.usefixtures("undrawn")
def test_a_fit_of_a_wrong_slope_names_the_cause_and_offers_what_mends_it(drops, run):
    """The board of drop-4 shows 20 deg; the centre of mass is 3 mm, not -9 mm, from the pivot."""
    edit(drops / "campaign.toml", '"20 deg"', '"25 deg"')
    edit(drops / "campaign.toml", '"3 mm"]', '"-9 mm"]')
    code, out, err = run("fit-gear", drops, *COARSE[:-1], "--no-check")
    assert code == 0
    cause = "drop-4: the campaign states slope = 25.0 deg, the log shows 20.0 deg from markers"
    mass = "off the stated centre of mass"
    heard = [line for line in err.splitlines() if line.startswith("warning: ")]
    assert cause in heard[0]
    folder = Path("fits") / "synthetic-lf"
    stated = json.loads((folder / "fit.json").read_text(encoding="utf-8"))["provenance"]["findings"]
    codes = [one["code"] for one in stated]
    assert codes[0] == "contradicts-slope"
    assert "centre-of-mass-off" in codes
    assert sum(mass in line for line in heard) == 1
    offered = out[out.index("next:") :]
    assert "sysid check " in offered
    assert "campaign.toml" in offered
    assert f"sysid explain {folder}" in offered
    assert "export" not in offered
    assert run("report", folder)[0] == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "the log shows 20.0 deg from markers" in page
    assert mass in page
    code, _, err = run("export", folder, "--out", "sets.json")
    assert (code, Path("sets.json").is_file()) == (0, True)
    assert err.count("warning: ") == 1
    assert "the model does not explain the trials, so no parameter is well known" in err


def test_a_minimal_campaign_says_what_the_logs_say_and_refuses_the_rest(tmp_path, run, refused):
    """The sample drops: names, slopes (one board is seen too briefly), axes; nothing of another drone."""
    target = tmp_path / "mine.toml"
    code, out, err = run("new-campaign", "gear", "--from", SAMPLES / "gear-lf", "--out", target)
    assert code == 0, err
    assert "sysid check" in out
    text = target.read_text(encoding="utf-8")
    stated = tomllib.loads(text)
    assert len(text.splitlines()) - len(stated["trials"]) <= 25
    slopes = [trial["slope"] for trial in stated["trials"]]
    wanted = ["5.0", "10.0", "15.0", "20.0", "27.0", "TODO", "12.0", "24.0"]
    assert slopes == [f"{slope} ± 0.2 deg" for slope in wanted]
    found = {key: stated["capture"][key] for key in ("rigid_body", "up", "down_slope")}
    assert found == {"rigid_body": "F450", "up": "+y", "down_slope": "-z"}
    names = ["still TODO: ", "drop-6-35deg-0.45mps'].slope", "vehicle.body_mass", "surface.law"]
    refused(names, "check", target)
    measured = {
        "body_mass": "1.242 kg", "body_inertia": "0.0137 kg·m²", "foot_dx": "105 mm", "foot_dz": "151 mm",
        "leg_mass": "0.02 kg", "leg_inertia": "2e-4 kg·m²", "kinetic_friction": "0.44", "law": "lf",
        "thrust_point_dx": "159 mm",
    }  # fmt: skip
    for key, value in measured.items():
        text = re.sub(rf'(?m)^{key} = "TODO[^"]*"', f'{key} = "{value}"', text)
    target.write_text(text.replace("TODO ± 1 mm", "0 ± 1 mm").replace("TODO", "35"), encoding="utf-8")
    assert read_campaign(target, "gear").trials[5].slope == pytest.approx(np.radians(35))


@pytest.mark.parametrize(
    ("levels", "direction"), [((0, 0.4, 1), "forward"), ((0, -0.4, -1), "reverse"), ((0.5, -0.5), "reversal")]
)
def test_shares_of_full_command_are_a_unit_of_campaigns(tmp_path, run, levels, direction):
    rows = [f"{i / 100},{levels[i * len(levels) // 300]},{300 + i},1,0.01,{11 + (i > 9)}" for i in range(300)]
    log, target = tmp_path / "duty.csv", tmp_path / "duty.toml"
    head = "Time (s),Command (1),Speed (rad/s),Fz (N),Mz (N·m),Voltage (V)"
    log.write_text("\n".join([head, *rows]), encoding="utf-8")
    code, _, err = run("new-campaign", "motor", "--minimal", "--from", log, "--out", target)
    assert code == 0, err
    text = target.read_text(encoding="utf-8").replace("TODO rpm/V ±", "900 rpm/V ±")
    assert re.search(r'(?m)^reference_voltage = "12 V" +# median of the logged supply voltage$', text)
    target.write_text(text.replace("TODO kg·m²", "2e-5 kg·m²"), encoding="utf-8")
    campaign = read_campaign(target, "motor")
    assert [trial.direction for trial in campaign.trials] == [direction]
    u = campaign_range(campaign).to_u(np.array(levels), "1", "duty.csv")
    np.testing.assert_array_equal(u, levels)


@pytest.mark.parametrize(("turns", "direction"), [(+1, "forward"), (-1, "reverse")])
def test_half_throttle_is_no_full_reverse(tmp_path, run, turns, direction):
    """From 1000 to 1500 µs a rotor of one direction speeds up, and one that reverses slows down."""
    rows = [f"{i / 100},{1000 + i // 60 * 100},{300 + turns * (i // 60)},1,0.01" for i in range(360)]
    log, target = tmp_path / "half.csv", tmp_path / "half.toml"
    log.write_text(
        "\n".join(["Time (s),Command (us),Speed (rad/s),Fz (N),Mz (N·m)", *rows]), encoding="utf-8"
    )
    assert run("new-campaign", "motor", "--minimal", "--from", log, "--out", target)[0] == 0
    stated = tomllib.loads(target.read_text(encoding="utf-8"))
    assert [trial["direction"] for trial in stated["trials"]] == [direction]
    assert ("neutral" in stated["command"]) == (direction == "reverse")


def test_a_new_campaign_reads_the_logs_with_the_options_and_states_them(tmp_path, run, refused):
    """A load cell without a clock and units: the options that `inspect` needs stand in the campaign."""
    log, target = tmp_path / "cell.csv", tmp_path / "cell.toml"
    log.write_text("tach,Fz,Mz,throttle\n" + "60,1,0.1,1100\n" * 50, encoding="utf-8")
    options = {
        "rate": ("1000", "1000 Hz"), "columns": ('{ speed = "tach" }', {"speed": "tach"}),
        "units": ('{speed="rpm",Fz="N",Mz="mN*m",command="us"}',
                  {"speed": "rpm", "Fz": "N", "Mz": "mN*m", "command": "us"}),
    }  # fmt: skip
    words = [word for name, (given, _) in options.items() for word in ("-o", f"{name}={given}")]
    refused([f"sysid inspect {log} shows all that is missing"],
            "new-campaign", "motor", "--from", log, "--out", target)  # fmt: skip
    code, _, err = run("new-campaign", "motor", "--from", log, *words, "--out", target)
    assert code == 0, err
    assert tomllib.loads(target.read_text(encoding="utf-8"))["log"] == {
        name: stated for name, (_, stated) in options.items()
    }
    measured = {"kv": "900 rpm/V", "rotor_inertia": "3e-5 kg·m²", "reference_voltage": "11 V"}
    text = target.read_text(encoding="utf-8")
    for key, value in measured.items():
        text = re.sub(rf'(?m)^{key} = "TODO[^"]*"', f'{key} = "{value}"', text)
    target.write_text(text, encoding="utf-8")
    campaign = read_campaign(target, "motor")
    recording, _ = read_log(campaign, target, campaign.trials[0])
    assert recording["torque"].values[0] == pytest.approx(1e-4)
    form = ("--format", "load-cell-csv")
    assert run("new-campaign", "motor", "--from", log, *form, *words, "--out", target, "--force")[0] == 0
    assert tomllib.loads(target.read_text(encoding="utf-8"))["log"]["format"] == "load-cell-csv"
    refused(["'tare' is for none"], "new-campaign", "motor", "--from", log, *words, "-o", "tare=1",
            "--out", tmp_path / "none.toml")  # fmt: skip
    assert not (tmp_path / "none.toml").exists()


def test_a_minimal_motor_campaign_tells_directions_and_curves_apart(tmp_path, run, refused):
    first, *others = (SAMPLES / "motor" / name for name in MOTOR_LOGS)
    target = tmp_path / "motor.toml"
    code, _, err = run("new-campaign", "motor", "--minimal", "--from", first, *others, "--out", target)
    assert code == 0, err
    stated = tomllib.loads(target.read_text(encoding="utf-8"))
    assert [trial["direction"] for trial in stated["trials"]] == ["forward", "reverse", "reversal"]
    curves = {kind: [row["direction"] for row in rows] for kind, rows in stated["curves"].items()}
    assert curves == {"static": ["forward"], "no_load": ["reverse"]}
    assert stated["command"] == {"unit": "us", "minimum": 1000, "neutral": 1500, "maximum": 2000}
    assert stated["motor"]["reference_voltage"] == "11.1 V"
    refused("still TODO: motor.kv, motor.rotor_inertia;", "fit-motor", target)
    wrong = ("new-campaign", "gear", "--from", first, "--out", tmp_path / "none.toml")
    refused(["forward-1.csv", "load-cell log", "leave this log out"], *wrong)
    assert not (tmp_path / "none.toml").exists()
    assert run("new-campaign", "motor", "--minimal", "--out", tmp_path / "empty.toml")[0] == 0
    refused("trials['trial-1'].log", "check", tmp_path / "empty.toml")


MOTOR_LOGS = ("forward-1.csv", "reverse-1.h5", "reversal-1.h5", "static-forward.csv", "no-load-reverse.csv")
FIRST = "drop-1-5deg-0.50mps.csv"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("body_mass", "body_mas", ("unknown key vehicle.body_mas", "'body_mass'")),
        ('"F450"', '"F550"', ("no rigid body", "F550", "F450", FIRST)),
        (FIRST, "drop-99.csv", ("log 'drop-99.csv' does not exist",)),
        ('down_slope = "-z"', 'down_slope = "+z"', ("surface", "capture.down_slope")),
        ('up = "+y"', 'up = "+x"', ("nothing falls", "capture.up")),
        ("[fit]", '[parameters.bounds]\njoint_dx = ["90 mm", "50 mm"]\n[fit]', ("joint_dx", "not below")),
        ("seed = 1", 'seed = "two"', "fit.seed: expected a whole number, found 'two'"),
        ("runs = 5", "population = 3", "fit.population: expected at least 8, found 3"),
        ("[fit]", '[fit]\nfinish = "soon"', "fit.finish: expected 'least-squares', 'cmaes' or 'none', found"),
        ("[surface]", "[[surface]]", "surface: expected a table"),
        ('name = "drop-1"', 'name = ""', "expected text that is not empty"),
        ('name = "drop-1"', f'name = "{"x" * 10_000}"', "expected at most 100 characters"),
        ('name = "drop-1"', 'name = "a\\nb"', "cannot be seen; use a name of one plain line"),
        ('name = "drop-1"', 'name = "a\\u202eb"', "'a\\u202eb' has characters that cannot be seen"),
        ('log = "drop-1', f'log = "{"x" * 10_000}', "does not exist"),
    ],
)
def test_mistakes_in_the_campaign_are_refused_shortly_and_in_our_words(old, new, words, drops, refused):
    edit(drops / "campaign.toml", old, new)
    said = refused(words, "fit-gear", drops / "campaign.toml", *SMALL)
    assert "Input" not in said
    assert "should" not in said
    assert len(said) < 1000
    assert not Path("fits").exists()


def rewrite(path, change):
    """Replace the lines of a Motive file by what `change` makes of them and of the first row's number."""
    path.write_text("".join(change(*body_rows(path))), encoding="utf-8", newline="")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines, first: [], ("empty",)),
        (lambda lines, first: lines[: first + 40], ("falls",)),
        (lambda lines, first: lines[:-180], ("record longer",)),
    ],
)
def test_broken_logs(change, words, drops, refused):
    rewrite(drops / FIRST, change)
    refused([FIRST, *words], "fit-gear", drops / "campaign.toml", *SMALL)
    assert not Path("fits").exists()


@pytest.fixture
def truth(drops):
    return json.loads((drops / "truth.json").read_text(encoding="utf-8"))["drops"][0]


def test_a_long_occlusion_inside_a_drop_is_refused(drops, truth, refused):
    def lose_body(lines, first):
        """Blank the body for 13 frames, 65 ms, 0.25 s after the touchdown, clear of other gaps."""
        start = first + int((truth["touchdown"] + 0.25) * 200) - truth["first_frame"]
        for i in range(start, start + 13):
            frame, time, *cells = lines[i].rstrip("\r\n").split(",")
            lines[i] = ",".join([frame, time, *[""] * len(cells)]) + "\r\n"
        return lines

    rewrite(drops / FIRST, lose_body)
    refused([FIRST, "'drop-1'", "lost for 65 ms", "50 ms"], "fit-gear", drops / "campaign.toml", *SMALL)


def test_rotation_out_of_the_plane_is_a_warning_with_the_trials_name(drops, truth, run):
    """A drone that rolls by 15 degrees after release breaks the planar assumption: noted, not refused."""
    # The samples' down-slope axis is -z: rolling is turning about it.
    turn = Rotation.from_rotvec([0.0, 0.0, -np.radians(15.0)])

    def roll(lines, first):
        quaternion = body_columns(lines, first)
        for i in range(first, len(lines)):
            cells = lines[i].rstrip("\r\n").split(",")
            if float(cells[1]) > truth["touchdown"] + 0.1 and cells[quaternion.start]:
                attitude = Rotation.from_quat([float(c) for c in cells[quaternion]])
                cells[quaternion] = [f"{c:.6f}" for c in (turn * attitude).as_quat()]
            lines[i] = ",".join(cells) + "\r\n"
        return lines

    rewrite(drops / FIRST, roll)
    code, _, err = run("fit-gear", drops / "campaign.toml", *COARSE[:-1])
    assert code == 0
    assert re.search(r"warning: (trial ')?drop-1'?: roll reaches 1[4-6] deg", err)


def test_foreign_and_missing_fits(tmp_path, refused):
    refused(["nowhere"], "show", tmp_path / "nowhere")
    foreign = tmp_path / "foreign.json"
    foreign.write_text("{}", encoding="utf-8")
    refused(["foreign.json"], "show", foreign)
    refused(["fit.h5"], "export", tmp_path, "--out", tmp_path / "x.json")


@pytest.mark.skipif(sys.platform != "linux", reason="needs a file system of its own size: Linux with root")
def test_a_full_disk_during_a_fit_is_one_sentence(drops, tmp_path):
    """In a process of its own: the HDF5 library writing to a full disk would take the process down."""
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(small)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"cannot mount a small file system here: {mounted.stderr.decode().strip()}")
    try:
        command = [sys.executable, "-m", "sysid", "fit-gear", str(drops / "campaign.toml"), *COARSE]
        done = subprocess.run(
            [*command, "--out", str(small / "f")],
            capture_output=True, text=True, encoding="utf-8", check=False,
        )  # fmt: skip
        assert done.returncode == 2, done.stderr
        assert [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        assert "space" in done.stderr
        assert "Traceback" not in done.stderr
        assert not (small / "f").exists()
    finally:
        subprocess.run(["umount", str(small)], check=True)


def test_a_slope_that_lifts_the_board_over_a_foot_is_the_likely_cause(drops, refused):
    edit(drops / "campaign.toml", '"15 deg"', '"20 deg"')
    words = (
        "trial 'drop-3': a foot is ",
        "check the slope",
        "; the likely cause: drop-3: the campaign states slope",
    )
    for verb in ("check", "fit-gear"):
        assert refused(words, verb, drops, "--quiet").count("20.0 deg, the log shows 15.0 deg") == 1


def test_a_choice_that_there_is_not_is_refused_in_words_of_the_command_line(drops, run):
    code, _, err = run("fit-gear", drops, "--finish", "lm")
    assert code == 2
    assert "'--finish': 'lm' is not one of 'least-squares', 'cmaes', 'none'" in err


def test_a_mass_in_grams_called_kilograms_is_refused_and_a_tenfold_one_has_no_verdict(drops, run, refused):
    edit(drops / "campaign.toml", '"1.242 kg"', '"13.1 kg"')
    code, out, err = run("check", drops / "campaign.toml")
    assert code == 3, err
    assert "no verdict" in out
    assert "warning: sqrt(body_inertia/body_mass) = " in err
    edit(drops / "campaign.toml", '"13.1 kg"', '"1310 kg"')
    words = ["sqrt(body_inertia/body_mass) = 3 mm is 0.018 of the feet's", "vehicles have 0.3 to 1.2"]
    refused(words, "check", drops / "campaign.toml")
    refused(words, "fit-gear", drops / "campaign.toml", "--out", "fit")
    assert not list(drops.parent.glob("fit*"))


def test_a_body_that_hangs_tilted_is_suspicious(drops, run):
    log = next(drops.glob("drop-1-*.csv"))
    _, level, _ = run("inspect", log)
    edit(log, ",X,Y,Z,,X,Y,Z,W,", ",X,Y,Z,,W,Y,Z,X,")
    _, tilted, _ = run("inspect", log)
    assert "off level before its release" not in level
    assert "off level before its release: check the order of the quaternion's components" in tilted


def test_what_nobody_foresaw_is_one_line_and_a_trace_in_a_file(tmp_path, monkeypatch, run):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def broken(*arguments):
        raise LookupError("no such\n\x1b[31mthing")

    monkeypatch.setattr("sysid.workflows.show.print_sets", broken)
    code, out, err = run("show", "a fit")
    (trace,) = tmp_path.glob("sysid-*.txt")
    assert (code, out) == (1, "")
    assert err == (
        "error: sysid show 'a fit' ended in a bug of sysid, not in a mistake of yours (LookupError: no such "
        f"\\u001b[31mthing); the trace is in {trace}; please report it with that file\n"
    )
    text = trace.read_text(encoding="utf-8")
    assert text.startswith("sysid show 'a fit'\n\nTraceback")
    assert "in broken" in text
    with pytest.raises(LookupError):
        run("show", "a fit", "--debug")


def test_what_is_no_fit_and_what_is_a_fit_of_another_kind(tmp_path, refused):
    fit = write_fit(full_fit(), tmp_path / "fit")
    words = "published-motor.json: is a .json file, which has neither runs nor trials; name the folder"
    refused(words, "compare", SAMPLES / "published" / "published-motor.json", fit)
    words = "campaign.toml: is a gear campaign, but the fit is a motor fit; name a motor campaign"
    refused(words, "validate", fit, SAMPLES / "gear-lf" / "campaign.toml")


def test_a_fit_that_its_budget_cut_is_not_listed_as_done(tmp_path, run):
    fit = full_fit()
    write_fit(fit, tmp_path / "whole")
    first, *others = fit.runs
    ended = replace(first.stages[-1], stop_reason="evaluations")
    short = replace(first, stages=(*first.stages[:-1], ended))
    write_fit(replace(fit, runs=(short, *others)), tmp_path / "short")
    _, listed, _ = run("fits", tmp_path, "--json")
    assert {entry["name"]: entry["state"] for entry in json.loads(listed)} == {
        "short": "cut",
        "whole": "done",
    }
    assert "runs of a cut fit ended by their budget" in run("fits", tmp_path)[1]


@pytest.mark.parametrize("arguments", [["-h"], ["formats"], ["formats", "--json"]])
def test_a_closed_pipe_is_silent_and_a_full_output_is_no_bug(arguments):
    command = [sys.executable, "-m", "sysid", *arguments]
    reader, writer = os.pipe()
    os.close(reader)
    closed = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (closed.returncode, closed.stderr) == (141, "")
    if Path("/dev/full").exists():
        with open("/dev/full", "w") as full:
            done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
        assert done.returncode == 2
        assert done.stderr.startswith("error: the output cannot be written (")
        assert done.stderr.count("\n") == 1
