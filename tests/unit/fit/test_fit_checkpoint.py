"""Checkpoints: finished stages continued to the same bits, refused when anything differs, one owner."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from fakes.bowl import Bowl, Decay, assert_same_run, assert_same_runs
from fakes.places import SAMPLES
from fakes.slow_fit import IDENTITY, SETTINGS
from sysid.errors import FitError
from sysid.fit import checkpoint as checkpoint_module
from sysid.fit.checkpoint import PROBES, PROCESSOR, Checkpoint, glance
from sysid.fit.search import Hooks, run_many
from sysid.fit.settings import SearchSettings
from sysid.fit.store import read_fit
from sysid.resume import BlockStore
from sysid.search_options import ALGORITHMS

# Populations of a run of `SETTINGS`: a stage of the GA, then one of CMA-ES.
STAGE = 14


def run_all(fit, objective=None, *, resume=False, flag=lambda: False, settings=SETTINGS, done=True, **more):
    hold = Checkpoint(fit, {**IDENTITY, **more}, resume=resume)
    try:
        found = run_many(objective or Bowl(), settings, checkpoint=hold, hooks=Hooks(should_stop=flag))
        return found, hold.notes
    finally:
        if done:
            hold.discard()
        else:
            hold.close()


def interrupted(fit, calls, objective=None, **more):
    """Leave the checkpoint of a fit that was stopped after so many populations, and return what it found."""
    objective = objective or Bowl()
    return run_all(fit, objective, flag=lambda: objective.calls >= calls, done=False, **more)[0]


@pytest.fixture(scope="module")
def whole():
    return run_many(Bowl(), SETTINGS)


@pytest.mark.parametrize("calls", [1, 13, 14, 15, 28, 29, 40, 80])
def test_resume_is_bit_identical_and_computes_one_stage_again(tmp_path, whole, calls):
    interrupted(tmp_path / "fit", calls)
    again = Bowl()
    found, notes = run_all(tmp_path / "fit", again, resume=True)
    assert_same_runs(found, whole)
    assert notes == []
    assert again.calls == sum(len(run.best) for run in whole) - STAGE * ((calls - 1) // STAGE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_goes_on_from_its_finished_stages(tmp_path, algorithm):
    settings = SearchSettings(40, 1, 5, 14, algorithm, "cmaes")
    whole = run_many(Bowl(), settings)
    for cut in sorted({1, 5, 15, len(whole[0].best)}):
        interrupted(tmp_path / "fit", cut, settings=settings)
        assert_same_runs(run_all(tmp_path / "fit", settings=settings, resume=True)[0], whole)


@pytest.mark.parametrize(
    ("rough", "wrong", "after"),
    [(0.0, 0.017, ["cmaes"]), (0.01, 0.017, ["cmaes"]), (0.0, 0.2, ["ga", "least-squares"])],
)
def test_what_follows_least_squares_begins_where_it_would_have(tmp_path, rough, wrong, after):
    settings = SearchSettings(40, 1, 5)
    whole = run_many(Decay(rough, wrong), settings)
    assert [stage.algorithm for stage in whole[0].stages] == ["ga", "least-squares", *after]
    third = sum(len(stage.cost) for stage in whole[0].stages[:2])
    for cut in sorted({1, 4, 9, 25, third + 3, len(whole[0].best) - 2}):
        interrupted(tmp_path / "fit", cut, Decay(rough, wrong), settings=settings)
        assert_same_runs(
            run_all(tmp_path / "fit", Decay(rough, wrong), settings=settings, resume=True)[0], whole
        )


def test_a_stage_after_one_that_the_clock_has_cut_is_not_kept(tmp_path):
    settings = SearchSettings(40, 1, 5, 14, "ga", "cmaes", time_limit=0.0)
    (cut,), _ = run_all(tmp_path / "fit", settings=settings, done=False)
    assert [(stage.stop_reason, len(stage.cost)) for stage in cut.stages] == [("time", 1), ("time", 1)]
    unlimited = replace(settings, time_limit=None)
    found, _ = run_all(tmp_path / "fit", settings=unlimited, resume=True)
    assert_same_runs(found, run_many(Bowl(), unlimited))


def test_what_was_found_is_there_when_the_next_attempt_is_stopped_early(tmp_path):
    first = interrupted(tmp_path / "fit", 2 * STAGE + 10)
    again = interrupted(tmp_path / "fit", 1, resume=True)
    assert len(again) == len(first) == 2
    assert_same_run(again[0], first[0])
    assert again[1].stop_reason == "interrupted"
    np.testing.assert_array_equal(again[1].best_point, first[1].best_point)
    assert again[1].best[-1] == first[1].best[-1] < again[1].best[0]


def test_more_runs_continue_the_same_fit(tmp_path, whole):
    interrupted(tmp_path / "fit", 20)
    found, _ = run_all(tmp_path / "fit", resume=True, settings=replace(SETTINGS, runs=4))
    assert_same_runs(found[:3], whole)
    assert len(found) == 4


def _flip(data, position):
    return data[:position] + bytes([data[position] ^ 0x10]) + data[position + 1 :]


DAMAGE = {
    "empty": lambda data: b"",
    "cut in half": lambda data: data[: len(data) // 2],
    "last byte lost": lambda data: data[:-1],
    "bit in the content": lambda data: _flip(data, len(data) // 3),
    "zeros": lambda data: bytes(len(data)),
    "another program's": lambda data: b"dust",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_stage_is_computed_again(tmp_path, whole, damage):
    interrupted(tmp_path / "fit", 20)
    for name in ("stage-1", "best"):
        path = Checkpoint.folder_of(tmp_path / "fit") / f"run-1-{name}.npz"
        path.write_bytes(DAMAGE[damage](path.read_bytes()))
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same_runs(found, whole)
    assert len(notes) == 2
    assert all("damaged (" in note and note.endswith("so it is computed again") for note in notes)


FORGED = {
    "no columns": lambda columns: (),
    "another number of parameters": lambda columns: (columns[0][:, :, :2], *columns[1:]),
    "too few costs": lambda columns: (columns[0], columns[1][:3], *columns[2:]),
    "costs that are no numbers": lambda columns: (columns[0], np.full_like(columns[1], np.nan), *columns[2:]),
    "costs as text": lambda columns: (columns[0], columns[1].astype(str), *columns[2:]),
    "no generation": lambda columns: (columns[0][:0], columns[1][:0], columns[2][:0], *columns[3:]),
    "axes of another space": lambda columns: (*columns[:5], np.eye(7), columns[6]),
    "another reason to end": lambda columns: (*columns[:6], _with(columns, "generations", "whim")),
    "a field too many": lambda columns: (
        *columns[:6],
        _with(columns, '"algorithm"', '"whim": 1, "algorithm"'),
    ),
    "no fields": lambda columns: (*columns[:6], np.array("[]")),
    "costs below nothing": lambda columns: (columns[0], np.full_like(columns[1], -1.0), *columns[2:]),
    "time that ran back": lambda columns: (*columns[:6], _stating(columns, wall_time=-1e9)),
    "fewer simulations than none": lambda columns: (*columns[:6], _stating(columns, simulations=-5)),
}


def _with(columns, old, new):
    return np.array(str(columns[6]).replace(old, new))


def _stating(columns, **fields):
    return np.array(json.dumps({**json.loads(str(columns[6])), **fields}))


@pytest.mark.parametrize("forged", FORGED)
def test_a_stage_whose_numbers_do_not_fit_is_computed_again(tmp_path, whole, forged):
    interrupted(tmp_path / "fit", 20)
    hold = Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
    BlockStore.save(hold, "run-1-stage-1", FORGED[forged](hold.load("run-1-stage-1")))
    hold.close()
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same_runs(found, whole)
    assert len(notes) == 1


def test_states_that_another_program_wrote_are_refused(tmp_path):
    interrupted(tmp_path / "fit", 20)
    hold = Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
    columns = hold.load("run-1-stage-1")
    BlockStore.save(hold, "run-1-stage-1", (*columns[:6], _with(columns, '"ga"', '"de"')))
    hold.close()
    with pytest.raises(FitError, match=r"ga follows where de did.*--force"):
        run_all(tmp_path / "fit", resume=True, done=False)
    identity = Checkpoint.folder_of(tmp_path / "fit") / "identity.json"
    for text in ("dust", "[1, 2]"):
        identity.write_text(text)
        with pytest.raises(FitError, match=r"cannot be continued \(.*discard it with --force"):
            run_all(tmp_path / "fit", resume=True)
    identity.unlink()
    with pytest.raises(FitError, match="cannot be continued"):
        run_all(tmp_path / "fit", resume=True)


def test_a_checkpoint_of_the_former_version_is_refused(tmp_path):
    folder = Checkpoint.folder_of(tmp_path / "fit")
    folder.mkdir()
    (folder / "run-1.h5").write_bytes(b"costs")
    with pytest.raises(FitError, match="unfinished fit is there; continue it with --resume"):
        Checkpoint(tmp_path / "fit", IDENTITY)
    with pytest.raises(FitError, match=r"run-1\.h5: an earlier version of sysid wrote .* --force"):
        Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
    Checkpoint(tmp_path / "fit", IDENTITY, force=True).close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"population": 60}, r"the population differs \(now 60, then 40\)"),
        ({"log drop-1": "ef" * 32}, r"log drop-1 differs \(now efefefefefef…, then cdcdcdcdcdcd…\)"),
        ({"log drop-2": "ef" * 32}, r"log drop-2 differs \(now efefefefefef…, then nothing\)"),
        ({PROBES: ["0x1"]}, r"the cost of the same candidates .* differs"),
    ],
)
def test_refused_when_anything_differs(tmp_path, change, words):
    interrupted(tmp_path / "fit", 20)
    folder = Checkpoint.folder_of(tmp_path / "fit")
    for _ in ("with its lock", "without"):
        before = sorted((p.name, p.stat().st_size) for p in folder.iterdir())
        with pytest.raises(FitError, match=words):
            Checkpoint(tmp_path / "fit", {**IDENTITY, **change}, resume=True)
        assert sorted((p.name, p.stat().st_size) for p in folder.iterdir()) == before
        (folder / "lock").unlink(missing_ok=True)


def test_on_another_processor_a_fit_goes_on_and_says_so(tmp_path, whole):
    interrupted(tmp_path / "fit", 33, **{PROCESSOR: "One 1", PROBES: ["0x1.0p0"]})
    other = {PROCESSOR: "Other 2", PROBES: ["0x1.00001p0"]}
    for flag, done in ((lambda: True, False), (lambda: False, True)):
        found, (note,) = run_all(tmp_path / "fit", resume=True, flag=flag, done=done, **other)
        assert "begun on another processor (One 1; this is Other 2): it goes on, but its result may" in note
    assert_same_runs(found, whole)


def test_costs_of_the_same_candidates_may_be_rounded_elsewhere_only(tmp_path):
    then = {PROCESSOR: "One 1", PROBES: [(0.1).hex(), (2.5).hex()]}
    elsewhere = {**then, PROCESSOR: "Other 2"}
    near, far = [[(0.1 * (1 + d)).hex(), (2.5).hex()] for d in (1e-9, 1e-3)]
    interrupted(tmp_path / "fit", 20, **then)
    for now in ({**then, PROBES: near}, {**elsewhere, PROBES: far}, {**elsewhere, PROBES: None}):
        with pytest.raises(FitError, match=r"the cost of the same candidates .* differs"):
            Checkpoint(tmp_path / "fit", {**IDENTITY, **now}, resume=True)
    Checkpoint(tmp_path / "fit", {**IDENTITY, **elsewhere, PROBES: near}, resume=True).close()


def test_neither_overwritten_nor_resumed_by_accident(tmp_path):
    with pytest.raises(FitError, match="holds nothing to continue"):
        Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
    assert list(tmp_path.iterdir()) == []
    interrupted(tmp_path / "fit", 20)
    with pytest.raises(FitError, match="unfinished fit is there; continue it with --resume"):
        Checkpoint(tmp_path / "fit", IDENTITY)
    Checkpoint(tmp_path / "fit", IDENTITY, force=True).close()
    assert list(tmp_path.iterdir()) == []


if sys.platform != "win32":  # which has no such limit

    def test_a_stage_that_the_system_refuses_to_write_is_said(tmp_path, whole):
        code = (
            "import resource, sys; from fakes.slow_fit import work;"
            "resource.setrlimit(resource.RLIMIT_FSIZE, (17000, 17000));"
            "work(sys.argv[1], False)"
        )
        full = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "fit")], capture_output=True, text=True
        )
        assert full.returncode == 1
        said = full.stderr.splitlines()[-1]
        assert "cannot be written (File too large)" in said
        assert "continue the fit with --resume" in said
        found, notes = run_all(tmp_path / "fit", resume=True)
        assert_same_runs(found, whole)
        assert notes == []


def test_the_best_so_far_is_written_every_second_and_where_a_stage_ends(tmp_path, monkeypatch):
    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    clock, written = Clock(), []
    monkeypatch.setattr(checkpoint_module, "time", clock)
    save = BlockStore.save
    monkeypatch.setattr(
        BlockStore,
        "save",
        lambda hold, name, columns: (written.append((clock.now, name)), save(hold, name, columns)),
    )

    class Slow(Bowl):
        def evaluate(self, cube):
            clock.now += 0.3
            return super().evaluate(cube)

    hold = Checkpoint(tmp_path / "fit", IDENTITY)
    (run,) = run_many(Slow(), replace(SETTINGS, runs=1), checkpoint=hold)
    assert glance(hold.folder)[:2] == (1, run.best[-1])
    hold.discard()
    bests = [when for when, name in written if name == "run-1-best"]
    assert bests[0] == pytest.approx(100.3)
    # Every fourth generation of 0.3 s, and both ends.
    assert len(bests) <= 2 + len(run.best) / 4
    assert [name for _, name in written if "stage" in name] == ["run-1-stage-1", "run-1-stage-2"]


# --- killed -------------------------------------------------------------------------------------------------


def started(fit, how):
    command = [sys.executable, "-m", "fakes.slow_fit", str(fit), how]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout.readline().strip() == b"begun"
    return process


@pytest.mark.parametrize(("fits", "moments"), [(1, 3), pytest.param(6, 5, marks=pytest.mark.slow)])
def test_killed_at_random_moments_one_after_the_other(tmp_path, whole, fits, moments):
    draw = random.Random(fits)
    for number in range(fits):
        fit = tmp_path / str(number)
        for _ in range(moments):
            process = started(fit, "resume" if Checkpoint.kept(Checkpoint.folder_of(fit)) else "start")
            time.sleep(draw.uniform(0.0, 0.25))
            process.kill()
            process.wait()
            process.stdout.close()
        found, notes = run_all(fit, resume=Checkpoint.kept(Checkpoint.folder_of(fit)))
        assert_same_runs(found, whole)
        # Even a kill inside a write damages nothing.
        assert notes == []


SMALL = ("--population", "16", "--runs", "2", "--max-generations", "8", "--no-check", "--no-trust", "--quiet")
FITS = {
    "gear": ("fit-gear", SAMPLES / "gear-lf"),
    "motor": ("fit-motor", SAMPLES / "motor"),
    "dask": ("fit-gear", SAMPLES / "gear-lf", "--dask", "local"),
}


def command_line(kind, out, *more):
    program = "import sys; from sysid.cli import app; sys.argv[0] = 'sysid'; app()"
    return [sys.executable, "-c", program, *map(str, FITS[kind]), *SMALL, "--out", str(out), *more]


def assert_same_fit(found, whole):
    found, whole = read_fit(found), read_fit(whole)
    assert found.state == whole.state == "done"
    assert_same_runs(found.runs, whole.runs)
    for name in ("values", "nrmse"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))


# How often each kind of fit is ended; the whole proof takes SYSID_MOMENTS=30 and some minutes per case.
MOMENTS = int(os.environ.get("SYSID_MOMENTS", "3"))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["killed", "interrupted"])
@pytest.mark.parametrize("kind", FITS)
def test_a_fit_that_is_ended_at_random_moments_goes_on_to_the_same_bits(tmp_path, kind, how):
    if kind == "dask":
        pytest.importorskip("distributed", reason="Dask comes with the extra 'cluster'")
    began = time.monotonic()
    subprocess.run(command_line(kind, tmp_path / "whole"), check=True, capture_output=True)
    longest, draw = time.monotonic() - began, random.Random(f"{kind} {how}")
    number, ended = 0, 0
    while ended < MOMENTS:
        number += 1
        out, done = tmp_path / str(number), False
        while not done:
            resume = ["--resume"] * Checkpoint.kept(Checkpoint.folder_of(out))
            process = subprocess.Popen(
                command_line(kind, out, *resume), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
            )
            try:
                process.wait(draw.uniform(0.0, longest) if ended < MOMENTS else None)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL if how == "killed" else signal.SIGINT)
                ended += 1
            said = process.communicate()[1].decode()
            # Before the command begins, while Python imports, Ctrl-C ends it as it ends any program.
            assert process.returncode in (0, -signal.SIGKILL, -signal.SIGINT, 130), said
            # A process that is ended on its way out has written its fit.
            done = out.exists() and not Checkpoint.kept(Checkpoint.folder_of(out))
            assert done or process.returncode != 0
        assert_same_fit(out, tmp_path / "whole")
        assert not Checkpoint.folder_of(out).exists()


def test_second_process_is_refused_and_a_crash_frees_the_folder(tmp_path):
    process = started(tmp_path / "fit", "start")
    try:
        with pytest.raises(FitError, match="another process is working on this fit; wait for it"):
            Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
        with pytest.raises(FitError, match="another process is working"):
            Checkpoint(tmp_path / "fit", IDENTITY, force=True)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    Checkpoint(tmp_path / "fit", IDENTITY, force=True).discard()
    assert list(tmp_path.iterdir()) == []
