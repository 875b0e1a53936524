"""A fit folder: read back as written, whole or not at all, refusals in one sentence."""

import errno
import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import sysid
from fakes.bowl import assert_same_runs
from fakes.fits import full_fit
from sysid import exact_json
from sysid.errors import FitError
from sysid.fit import store
from sysid.fit.store import check_new_fit, read_fit, summary, write_fit
from sysid.fit.summary import _CAUSES, record_lines
from sysid.gear.problem import GearProblem
from sysid.motor.problem import MotorProblem


def assert_same(a, b):
    assert a.parameter_sets() == b.parameter_sets()
    assert (a.kind, a.name, a.state, a.warnings) == (b.kind, b.name, b.state, b.warnings)
    np.testing.assert_array_equal(a.cube, b.cube)
    assert_same_runs(a.runs, b.runs)
    assert [run.wall_time for run in a.runs] == [run.wall_time for run in b.runs]
    for x, y in zip(a.trials, b.trials, strict=True):
        assert (x.name, x.use) == (y.name, y.use)
        for field in ("time", "measured", "valid", "simulated", "nrmse"):
            np.testing.assert_array_equal(getattr(x, field), getattr(y, field))


def leftovers(folder):
    return sorted(p.name for p in Path(folder).iterdir() if p.name.startswith("."))


def test_round_trip(tmp_path):
    fit = full_fit(state="stopped")
    path = write_fit(fit, tmp_path / "fits" / "bench")
    assert sorted(p.name for p in path.iterdir()) == ["fit.h5", "fit.json", "summary.txt"]
    assert_same(read_fit(path), fit)
    assert_same(read_fit(path / "fit.h5"), fit)
    assert leftovers(path.parent) == []


def test_folder_is_a_parameter_set_source(tmp_path):
    fit = full_fit()
    path = write_fit(fit, tmp_path / "bench")
    assert sysid.load_parameter_sets(path) == fit.parameter_sets()
    for name in ("fit.json", "fit.h5"):
        assert sysid.load_parameter_sets(path / name) == fit.parameter_sets()
    document = json.loads((path / "fit.json").read_text(encoding="utf-8"))
    assert document["sets"][0]["values"]["saturation_current"] == "Infinity"


def changed(path, change):
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document, indent=2), encoding="utf-8")


CHANGES = {
    "a value": lambda d: d["sets"][1]["values"].update(leg_axial_stiffness=9999.0),
    "a unit": lambda d: d["parameters"][0].update(unit="furlong"),
    "a setting": lambda d: d["settings"].update(whim=1),
    "an interval": lambda d: d["settings"].update(intervals={}),
    "the provenance": lambda d: d["provenance"].update(numpy="0.1"),
    "a use": lambda d: d["trials"][0].update(use="validate"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_copy_that_has_changed_is_refused_wherever_the_fit_is_opened(tmp_path, change):
    path = write_fit(full_fit(), tmp_path / "bench")
    changed(path / "fit.json", CHANGES[change])
    words = r"fit.json: fit.json has changed since sysid wrote it \(another SHA-256\); restore the file that"
    for name in (".", "fit.json", "fit.h5"):
        for read in (sysid.load_parameter_sets, sysid.load_fit):
            if (read, name) != (sysid.load_fit, "fit.json"):
                with pytest.raises(FitError, match=words):
                    read(path / name)
    # Elsewhere it is a file of sets like any other.
    copy = tmp_path / "fit.json"
    copy.write_bytes((path / "fit.json").read_bytes())
    if change == "a value":
        assert sysid.load_parameter_sets(copy)["leg_axial_stiffness"][1] == 9999.0
    (path / "fit.json").write_text("{", encoding="utf-8")
    with pytest.raises(FitError, match=r"damaged or cut off .*; restore the file that was changed"):
        read_fit(path)
    (path / "fit.json").unlink()
    assert sysid.load_parameter_sets(path) == full_fit().parameter_sets()


def test_a_fit_that_has_changed_is_refused(tmp_path):
    """Texts and attributes of HDF5 have no checksums: a longer name of a trial passes its library."""
    path = write_fit(full_fit(), tmp_path / "bench")
    with h5py.File(path / "fit.h5", "r+") as file:
        file["trials/1"].attrs["name"] = "another drop"
    with pytest.raises(FitError, match=r"fit.json: fit.h5 has changed since sysid wrote it"):
        read_fit(path)
    # The copy of an older version names no digest: all numbers are those of fit.h5.
    changed(path / "fit.json", lambda d: d.pop("sha256"))
    assert read_fit(path).trials[0].name == "another drop"


@pytest.mark.parametrize(
    "digest", [{"../fit.h5": "0" * 64}, {"fit.h5": "x"}, {"nul\0": "0" * 64}, {"": "0" * 64}]
)
def test_a_forged_digest_reaches_no_other_folder(tmp_path, digest):
    path = write_fit(full_fit(), tmp_path / "bench")
    changed(path / "fit.json", lambda d: d.update(sha256=digest))
    with pytest.raises(FitError, match=r"damaged or cut off \(sha256"):
        read_fit(path)


@pytest.mark.parametrize("name", ["trials/1/simulated", "sets/values", "sets/nrmse", "runs/1/stages/1/cost"])
def test_a_flipped_bit_in_an_array_is_seen(tmp_path, name):
    path = write_fit(full_fit(), tmp_path / "bench") / "fit.h5"
    # Without the digest of the whole file.
    path.with_name("fit.json").unlink()
    with h5py.File(path) as file:
        chunk = file[name].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    # Deflate has a checksum of its own at its end, HDF5's follows it.
    data[chunk.byte_offset + chunk.size - 1] ^= 1
    path.write_bytes(data)
    with pytest.raises(FitError, match="damaged or cut off"):
        read_fit(path)


def test_mean_nrmse_weights_channels_and_splits_uses():
    fit = full_fit()
    by_trial = fit.nrmse_by_trial @ np.array([0.25, 0.75])
    np.testing.assert_allclose(fit.mean_nrmse("fit"), by_trial[:, :2].mean(axis=1), rtol=1e-14)
    np.testing.assert_allclose(fit.mean_nrmse("validate"), by_trial[:, 2], rtol=1e-14)


def test_summary_names_what_matters(tmp_path):
    text = summary(full_fit())
    for words in (
        "motor fit bench: done",
        "leg_axial_stiffness",
        "saturation_current (fixed)",
        "body_mass (measured)",
        "leg_length (derived)",
        "drop-3  validate",
        "NRMSE change below the tolerance",
        "ends at the lower bound",
        "std of the measurement",
    ):
        assert words in text


def test_existing_folder_is_refused_then_replaced(tmp_path):
    old, new = full_fit(seed=1), full_fit(seed=2)
    path = write_fit(old, tmp_path / "bench")
    with pytest.raises(FitError, match=r"bench exists already; .* --force"):
        write_fit(new, path)
    with pytest.raises(FitError, match="exists already"):
        check_new_fit(path)
    check_new_fit(path, force=True)
    assert_same(read_fit(path), old)
    write_fit(new, path, force=True)
    assert_same(read_fit(path), new)
    assert leftovers(tmp_path) == []


def test_a_folder_that_is_no_fit_is_never_replaced(tmp_path):
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter-1.txt").write_text("years of work", encoding="utf-8")
    with pytest.raises(FitError, match=r"holds no fit.h5, so it is not a result folder"):
        write_fit(full_fit(), folder, force=True)
    assert (folder / "chapter-1.txt").read_text(encoding="utf-8") == "years of work"


def test_an_empty_folder_is_used(tmp_path):
    (tmp_path / "bench").mkdir()
    write_fit(full_fit(), tmp_path / "bench")
    assert_same(read_fit(tmp_path / "bench"), full_fit())


def test_full_disk_leaves_the_old_fit(tmp_path, monkeypatch):
    old = full_fit(seed=1)
    path = write_fit(old, tmp_path / "bench")
    renamed, calls = os.replace, []

    def second_fails(source, target):
        calls.append(target)
        if len(calls) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        renamed(source, target)

    monkeypatch.setattr(os, "replace", second_fails)
    with pytest.raises(FitError, match=r"cannot be written \(No space left on device\); .* unchanged"):
        write_fit(full_fit(seed=2), path, force=True)
    monkeypatch.undo()
    assert_same(read_fit(path), old)
    assert leftovers(tmp_path) == []


def test_hdf5_is_built_in_memory(tmp_path, monkeypatch):
    """The HDF5 library, writing to a full disk itself, crashes the process; it never sees the disk."""
    targets = []
    real = h5py.File
    monkeypatch.setattr(h5py, "File", lambda target, mode: (targets.append(target), real(target, mode))[1])
    write_fit(full_fit(), tmp_path / "bench")
    assert [type(target) for target in targets] == [io.BytesIO]


def test_interrupt_while_writing_leaves_nothing(tmp_path, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(store, "summary", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_fit(full_fit(), tmp_path / "bench")
    assert list(tmp_path.iterdir()) == []


def test_a_kill_while_writing_leaves_the_old_fit(tmp_path):
    path = write_fit(full_fit(seed=1), tmp_path / "bench")
    code = (
        "import os, sys; from fakes.fits import full_fit; from sysid.fit import store;"
        "store.summary = lambda result: os._exit(9);"
        "store.write_fit(full_fit(seed=2), sys.argv[1], force=True)"
    )
    killed = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True)
    assert killed.returncode == 9, killed.stderr
    assert_same(read_fit(path), full_fit(seed=1))
    # What the killed process left does not stand in the way of the next one.
    write_fit(full_fit(seed=3), path, force=True)
    assert_same(read_fit(path), full_fit(seed=3))


def test_damaged_fits_are_refused(tmp_path):
    path = write_fit(full_fit(), tmp_path / "bench")
    whole = (path / "fit.h5").read_bytes()
    (path / "fit.json").unlink()
    with pytest.raises(FitError, match=r"is not there"):
        read_fit(tmp_path / "nowhere")
    for cut in (0, 7, 100, len(whole) // 2, len(whole) - 1):
        (path / "fit.h5").write_bytes(whole[:cut])
        with pytest.raises(FitError, match="damaged or cut off"):
            read_fit(path)
    for change, words in (
        (lambda file: file.attrs.clear(), "not a fit of sysid"),
        (lambda file: file.attrs.modify("version", 99), "a fit of version 99, expected 3"),
        (lambda file: file.pop("runs/2/stages/1/cost"), "damaged"),
    ):
        (path / "fit.h5").write_bytes(whole)
        with h5py.File(path / "fit.h5", "r+") as file:
            change(file)
        with pytest.raises(FitError, match=words):
            read_fit(path)


def test_settings_must_be_text_and_numbers():
    with pytest.raises(TypeError, match="has no place in a result file"):
        replace(full_fit(), settings={"law": object()})


def test_trajectory_shapes_are_checked():
    fit = full_fit()
    bad = replace(fit.trials[0], simulated=np.zeros((3, 49, 2)))
    with pytest.raises(ValueError, match="trial drop-1: simulated"):
        replace(fit, trials=(bad, *fit.trials[1:]))


def test_failures_are_told_by_cause_in_text_and_numbers(tmp_path):
    path = write_fit(full_fit(), tmp_path / "bench")
    # 1 + 2 + 3 + 4 + 5 in each of two stages, and 2 in five generations of each.
    assert read_fit(path).runs[0].failures == {"diverged": 30, "left_the_board": 20}
    told = (path / "summary.txt").read_text(encoding="utf-8")
    assert "failed: 30 diverged, 20 left the board" in told
    assert "  left the board: the drone slid or bounced off the board" in told
    assert {*GearProblem.causes, *MotorProblem.causes} == {*_CAUSES}
    with h5py.File(path / "fit.h5") as file:
        counts = file["runs/1/stages/1/failed_by_cause"]
        assert counts[()].tolist() == [[0, 0], *([g, 2] for g in range(1, 6))]
        record = exact_json.loads(file["record_json"].asstr()[()])
    by_cause = record["runs"][0]["stages"][0]["failures"]
    assert by_cause == {"diverged": 15, "left_the_board": 10}


def _replaced_by(make):
    def change(file):
        del file["sets/nrmse"]
        make(file)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            _replaced_by(lambda f: f.update({"sets/nrmse": h5py.ExternalLink("/etc/passwd", "/x")})),
            "is a link",
        ),
        (_replaced_by(lambda f: f.update({"sets/nrmse": h5py.SoftLink("/sets/nrmse")})), "is a link"),
        (
            _replaced_by(lambda f: f["sets"].create_dataset("nrmse", (5,), "f8", external="/etc/passwd")),
            "lies in another place",
        ),
        (
            _replaced_by(lambda f: f["sets"].create_virtual_dataset("nrmse", h5py.VirtualLayout((5,), "f8"))),
            # Older h5py writes an empty array instead.
            "(lies in another place|claims more values than the file has bytes for)",
        ),
        (
            _replaced_by(lambda f: f["sets"].create_dataset("nrmse", (10**12,), "f8", chunks=(1000,))),
            "claims more values than the file has bytes for",
        ),
        (
            _replaced_by(lambda f: f["sets"].create_dataset("nrmse", data=[f.ref] * 5, dtype=h5py.ref_dtype)),
            "has neither numbers nor text",
        ),
        (lambda f: f["sets"].update({"again": f["/"]}), None),
    ],
    ids=[
        "external link",
        "soft-link loop",
        "external data",
        "virtual",
        "promise",
        "object",
        "hard-link loop",
    ],
)
def test_a_fit_that_reaches_outside_or_promises_too_much_is_refused(tmp_path, change, words):
    path = write_fit(full_fit(), tmp_path / "bench")
    with h5py.File(path / "fit.h5", "r+") as file:
        change(file)
    if words is None:
        (path / "fit.json").unlink()
        assert_same(read_fit(path), full_fit())
        return
    with pytest.raises(FitError, match=f"damaged or cut off .*{words}.*; run the fit again"):
        read_fit(path)


def test_a_record_in_words_keeps_every_digit_of_a_clock():
    record = {"release": 1_699_999_999.125, "cutoff": 12.345678, "campaign": {"text": "a = 1\nb = 2\n"}}
    lines = record_lines(record)
    assert lines[0] == "release [s]: 1699999999.125"
    assert lines[1] == "cutoff [Hz]: 12.3457"
    assert lines[2:] == ["campaign", "  text", "    a = 1", "    b = 2"]
    # Numbers inside lists are rounded as well.
    spans = {"starts_from_rest": [[15.6113, 16.438499999999998]], "channels": [{"ratio": 0.7898635677982466}]}
    assert record_lines(spans)[1] == "  [15.6113, 16.4385]"
    assert record_lines(spans)[3] == "  ratio: 0.789864"
