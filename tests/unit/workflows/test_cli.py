"""The command line as a user meets it: results, and refusals in one sentence with exit code 2."""

import ctypes
import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import typer
from scipy.spatial.transform import Rotation

import sysid
from sysid.cli.adapter import command


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


SMALL = ("--population", "16", "--runs", "2", "--max-generations", "2", "--quiet")


def test_fit_gear_show_export_and_read_back(drops, run, tmp_path, refused):
    campaign = drops / "campaign.toml"
    code, out, err = run("fit-gear", campaign, *SMALL)
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
    refused(["exists", "--force"], "fit-gear", campaign, *SMALL)
    refused(["exists already"], "export", folder, "--out", "sets.json")
    assert run("fit-gear", campaign, *SMALL, "--force")[0] == 0


def test_an_early_ctrl_c_says_so(monkeypatch, run):
    app = typer.Typer()

    @command(app, "wait", "sysid wait")
    def wait() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sysid.cli.app", app)
    assert run() == (130, "", "stopped by the user\n")


def test_ctrl_c_outlives_a_compiler_that_swallows_exceptions(monkeypatch, run):
    """In any command: an exception in a callback of LLVM is printed by ctypes and forgotten."""
    app = typer.Typer()
    swallowed = []
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    compiler = {"__name__": "llvmlite.binding.ffi", "callback": callback}
    exec("def optimize():\n    callback()", compiler)
    monkeypatch.setattr(sys, "unraisablehook", swallowed.append)

    @command(app, "wait")
    def wait() -> None:
        compiler["optimize"]()
        time.sleep(5.0)
        raise AssertionError("not heard")

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr("sysid.cli.app", app)
    assert run() == (130, "", "stopped by the user\n")
    assert swallowed == []
    assert signal.getsignal(signal.SIGINT) is before


def test_printing_a_fit_imports_nothing_slow():
    """`sysid show` takes half a second of processor time; any of these modules would take longer."""
    code = "import sys, sysid.workflows.show as _; print(*({'scipy', 'numba', 'pandas'} & {*sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_new_campaign_writes_a_template(tmp_path, run, refused):
    target = tmp_path / "mine.toml"
    code, out, _ = run("new-campaign", "motor", "--out", target)
    assert code == 0
    assert "fit-motor" in out
    assert "datasheet" in target.read_text(encoding="utf-8")
    refused(["exists already"], "new-campaign", "motor", "--out", target)


FIRST = "drop-1-5deg-0.50mps.csv"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("body_mass", "body_mas", ("unknown key vehicle.body_mas", "'body_mass'")),
        ('"F450"', '"F550"', ("no rigid body", "F550", "F450", FIRST)),
        (FIRST, "drop-99.csv", ("log 'drop-99.csv' does not exist",)),
        ('down_slope = "-z"', 'down_slope = "+z"', ("surface", "capture.down_slope")),
        ('up = "+y"', 'up = "+x"', ("nothing falls", "capture.up")),
        ("[fit]", "[fit]\npopulation = 2", ("fit.population",)),
        ("[fit]", '[parameters.bounds]\njoint_dx = ["90 mm", "50 mm"]\n[fit]', ("joint_dx", "not below")),
    ],
)
def test_typing_mistakes_in_the_campaign(old, new, words, drops, refused):
    edit(drops / "campaign.toml", old, new)
    refused(words, "fit-gear", drops / "campaign.toml", *SMALL)
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
    code, _, err = run("fit-gear", drops / "campaign.toml", *SMALL[:-1])
    assert code == 0
    assert re.search(r"warning: (trial ')?drop-1'?: roll reaches 1[4-6] deg", err)


def test_a_full_disk_during_export_leaves_the_old_file(drops, monkeypatch, run, refused):
    assert run("fit-gear", drops / "campaign.toml", *SMALL)[0] == 0
    folder = Path("fits") / "synthetic-lf"
    assert run("export", folder, "--out", "sets.json")[0] == 0
    before = Path("sets.json").read_bytes()

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    refused(["sets.json", "space"], "export", folder, "--out", "sets.json", "--force")
    assert Path("sets.json").read_bytes() == before
    assert [p.name for p in Path().iterdir() if p.name.startswith("sets")] == ["sets.json"]


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
        command = [sys.executable, "-m", "sysid", "fit-gear", str(drops / "campaign.toml"), *SMALL]
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
