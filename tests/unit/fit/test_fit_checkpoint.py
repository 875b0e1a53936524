"""Checkpoints: whole or not at all, continued to the same bits, refused when anything differs, one owner."""

import errno
import io
import os
import random
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from fakes.bowl import Bowl, assert_same_run
from fakes.slow_fit import IDENTITY, SETTINGS
from sysid.errors import FitError
from sysid.fit import checkpoint as checkpoint_module
from sysid.fit import search as engine_module
from sysid.fit.breeders.algorithms import breeder
from sysid.fit.checkpoint import (
    PROBES,
    PROCESSOR,
    Checkpoint,
    read_state,
    run_numbers,
    state_files,
)
from sysid.fit.run_log import RunMemory
from sysid.fit.search import Hooks, run_many
from sysid.fit.settings import SearchSettings, StopRule
from sysid.fit.stopping import StopFlag
from sysid.fit.trial import Evaluation


def run_all(
    fit,
    objective=None,
    *,
    resume=False,
    flag=lambda: False,
    settings=SETTINGS,
    done=True,
    breeds=breeder,
    **more,
):
    hold = Checkpoint(fit, {**IDENTITY, **more}, resume=resume)
    try:
        hooks = Hooks(keep=hold.keep, should_stop=flag)
        found = run_many(objective or Bowl(), settings, memories=hold.memories, hooks=hooks, breeds=breeds)
        return found, hold.notes
    finally:
        if done:
            hold.discard()
        else:
            hold.close()


def interrupted(fit, calls, **more):
    """Leave the checkpoint of a fit that was stopped after so many populations."""
    objective = Bowl()
    run_all(fit, objective, flag=lambda: objective.calls >= calls, done=False, **more)
    return objective.calls


@pytest.fixture(scope="module")
def whole():
    return run_many(Bowl(), SETTINGS)


def assert_same(found, whole):
    assert len(found) == len(whole)
    for a, b in zip(found, whole, strict=True):
        assert_same_run(a, b)


@pytest.mark.parametrize("calls", [1, 13, 14, 15, 28, 29, 40, 80])
def test_resume_is_bit_identical(tmp_path, whole, calls):
    done = interrupted(tmp_path / "fit", calls)
    again = Bowl()
    found, notes = run_all(tmp_path / "fit", again, resume=True)
    assert_same(found, whole)
    assert notes == []
    # Nothing is simulated twice, and nothing is left behind.
    assert done + again.calls == sum(len(run.best) for run in whole)
    assert list(tmp_path.iterdir()) == []


def test_more_runs_continue_the_same_fit(tmp_path, whole):
    interrupted(tmp_path / "fit", 20)
    found, _ = run_all(
        tmp_path / "fit", resume=True, settings=SearchSettings(40, 4, 5, SETTINGS.stop, "ga", "cmaes")
    )
    assert_same(found[:3], whole)
    assert len(found) == 4


def test_state_is_an_hdf5_file_that_says_what_it_is(tmp_path):
    interrupted(tmp_path / "fit", 20)
    path, _ = state_files(Checkpoint.folder_of(tmp_path / "fit"), 1)
    with h5py.File(path, "r") as file:
        assert file.attrs["schema"] == "sysid-checkpoint"
        assert file["stages/1/cost"].shape == (14 * 40,)
        assert file.userblock_size == 512
    memory, identity = read_state(path)
    assert identity == IDENTITY
    assert [stage.algorithm for stage in memory.stages] == ["ga", "cmaes"]
    assert [stage.ended for stage in memory.stages] == ["generations", "interrupted"]


def _flip(data, position):
    return data[:position] + bytes([data[position] ^ 0x10]) + data[position + 1 :]


DAMAGE = {
    "empty": lambda data: b"",
    "header only": lambda data: data[:512],
    "cut in half": lambda data: data[: len(data) // 2],
    "last byte lost": lambda data: data[:-1],
    "bit in the header": lambda data: _flip(data, 40),
    "bit in the content": lambda data: _flip(data, 2 * len(data) // 3),
    "last bit": lambda data: _flip(data, len(data) - 1),
    "zeros": lambda data: bytes(len(data)),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_detected_and_the_previous_state_used(tmp_path, whole, damage):
    interrupted(tmp_path / "fit", 20)
    current, previous = state_files(Checkpoint.folder_of(tmp_path / "fit"), 1)
    assert previous.is_file()
    current.write_bytes(DAMAGE[damage](current.read_bytes()))
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same(found, whole)
    assert len(notes) == 1
    assert "run-1.h5: damaged or cut off" in notes[0]
    # The previous state is that of the first stage's end.
    assert notes[0].endswith("run 1 goes on from the state before, 14 generations")


def _edited(change):
    """Return what gives a state another content under a checksum that fits."""

    def rewritten(data):
        buffer = io.BytesIO(data[512:])
        with h5py.File(buffer, "r+") as file:
            change(file)
        content = buffer.getvalue()
        return checkpoint_module._header(content) + content

    return rewritten


def _replaced(name, values):
    def change(file):
        del file[name]
        file[name] = values

    return _edited(change)


FOREIGN = {
    "another program's HDF5": _edited(lambda file: file.attrs.clear()),
    "another version": _edited(lambda file: file.attrs.modify("version", 99)),
    "no HDF5": lambda data: checkpoint_module._header(b"garbage") + b"garbage",
    "nothing": lambda data: checkpoint_module._header(b""),
    "no seed": _edited(lambda file: file.attrs.pop("seed")),
    "no costs": _edited(lambda file: file.pop("stages/1/cost")),
    "too few costs": _replaced("stages/1/cost", np.zeros(7)),
    "costs without end": _edited(lambda file: _promise(file, "stages/1/cost")),
    "costs that are no numbers": _replaced("stages/1/cost", np.full(560, np.nan)),
    "costs as text": _replaced("stages/1/cost", "text"),
    "a group in place of costs": _edited(lambda f: (f.pop("stages/1/cost"), f.create_group("stages/1/cost"))),
    "sizes that go back": _replaced("stages/1/candidates", np.array([600, -40])),
    "too many generations": _replaced("stages/1/elapsed", np.zeros(99)),
    "stages without the first": _edited(lambda file: file.pop("stages/1")),
    "an identity that is a list": _replaced("identity_json", "[1, 2]"),
    "causes that are numbers": _replaced("stages/1/causes_json", "[" + ", ".join(["3"] * 14) + "]"),
}


def _promise(file, name):
    del file[name]
    file.create_dataset(name, (10**12,), "f8", chunks=(1024,))


@pytest.mark.parametrize("foreign", FOREIGN)
def test_a_state_of_another_program_is_refused_and_the_previous_one_used(tmp_path, whole, foreign):
    interrupted(tmp_path / "fit", 20)
    states = state_files(Checkpoint.folder_of(tmp_path / "fit"), 1)
    kept = [path.read_bytes() for path in states]
    strange = FOREIGN[foreign](kept[0])
    for path in states:
        path.write_bytes(strange)
    with pytest.raises(FitError, match=r"run-1\.h5: ") as refusal:
        Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
    assert "start the fit again with --force" in str(refusal.value)
    # Nothing is lost: what lay there still does, and the state before can be continued.
    assert [path.read_bytes() for path in states] == [strange, strange]
    states[1].write_bytes(kept[1])
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same(found, whole)
    assert notes[0].endswith("run 1 goes on from the state before, 14 generations")


@pytest.mark.parametrize(
    ("name", "values"),
    [("stages/1/asked", np.arange(14, dtype=np.uint64)), ("stages/1/candidates", [20, 60, *([40] * 12)])],
)
def test_a_state_that_another_search_wrote_is_refused(tmp_path, name, values):
    interrupted(tmp_path / "fit", 20)
    current, _ = state_files(Checkpoint.folder_of(tmp_path / "fit"), 1)
    current.write_bytes(_replaced(name, values)(current.read_bytes()))
    with pytest.raises(FitError, match="generation 1 of ga asks for other candidates than were scored"):
        run_all(tmp_path / "fit", resume=True, done=False)
    current.write_bytes(
        _edited(lambda file: file["stages/1"].attrs.modify("algorithm", "de"))(current.read_bytes())
    )
    with pytest.raises(FitError, match="ga follows where de did"):
        run_all(tmp_path / "fit", resume=True, done=False)


def test_a_kill_between_the_two_renames_loses_nothing_but_a_second(tmp_path, whole):
    interrupted(tmp_path / "fit", 20)
    state_files(Checkpoint.folder_of(tmp_path / "fit"), 1)[0].unlink()
    assert run_numbers(Checkpoint.folder_of(tmp_path / "fit")) == [1]
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same(found, whole)
    assert notes == []


def test_both_states_damaged_starts_that_run_anew(tmp_path, whole):
    interrupted(tmp_path / "fit", 20)
    for path in state_files(Checkpoint.folder_of(tmp_path / "fit"), 1):
        path.write_bytes(b"dust")
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same(found, whole)
    assert "nothing of run 1 can be used, it starts again" in notes[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"population": 60}, r"the population differs \(now 60, then 40\)"),
        ({"log drop-1": "ef" * 32}, r"log drop-1 differs \(now efefefefefef…, then cdcdcdcdcdcd…\)"),
        ({"log drop-2": "ef" * 32}, r"log drop-2 differs \(now efefefefefef…, then nothing\)"),
    ],
)
def test_refused_when_anything_differs(tmp_path, change, words):
    interrupted(tmp_path / "fit", 20)
    folder = Checkpoint.folder_of(tmp_path / "fit")
    before = sorted((p.name, p.stat().st_size) for p in folder.iterdir())
    with pytest.raises(FitError, match=words):
        Checkpoint(tmp_path / "fit", {**IDENTITY, **change}, resume=True)
    assert (
        sorted((p.name, p.stat().st_size) for p in Checkpoint.folder_of(tmp_path / "fit").iterdir()) == before
    )


class Rounded:
    """A breeder as another processor would breed: its candidates differ in their last digits."""

    def __init__(self, *arguments):
        self._inner = breeder(*arguments)

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def ask(self):
        points = self._inner.ask()
        return None if points is None else np.minimum(points * (1 + 1e-13), 1.0)


class Turned(Rounded):
    """From the sixth generation of a stage on it breeds something else altogether."""

    def __init__(self, name, n_free, population, seed, start):
        super().__init__(name, n_free, population, seed, start)
        self._other = breeder(name, n_free, population, seed + 1, start)
        self._asked = 0

    def ask(self):
        self._asked += 1
        if self._asked == 6:
            self._inner = self._other
        return self._inner.ask()


ELSEWHERE = {PROCESSOR: "Other 2"}


def test_on_another_processor_a_fit_goes_on_and_says_so(tmp_path, whole):
    begun = {PROCESSOR: "One 1"}
    done = interrupted(tmp_path / "fit", 33, **begun)
    again = Bowl()
    found, notes = run_all(tmp_path / "fit", again, resume=True, breeds=Rounded, **ELSEWHERE)
    # Rounding costs no simulation, and what was paid for counts.
    assert done + again.calls == sum(len(run.best) for run in found)
    (note,) = notes
    assert "begun on another processor (One 1; this is Other 2): it goes on, but its result may" in note
    for a, b in zip(found, whole, strict=True):
        # Both end at the bowl's bottom of 0.01, within the tolerance of 1e-5 of CMA-ES.
        assert a.best[-1] == pytest.approx(b.best[-1], abs=2e-5)

    # On the same processor other candidates mean another library, which is refused.
    interrupted(tmp_path / "same", 33, **begun)
    with pytest.raises(FitError, match="asks for other candidates than were scored, so a library"):
        run_all(tmp_path / "same", resume=True, breeds=Rounded, **begun)


def test_on_another_processor_twice(tmp_path):
    interrupted(tmp_path / "fit", 20, **{PROCESSOR: "One 1"})
    first = Bowl()
    run_all(
        tmp_path / "fit", first, resume=True, done=False, breeds=Rounded,
        flag=lambda: first.calls >= 15, **ELSEWHERE,
    )  # fmt: skip
    # What this processor has continued is its own: the same bits are promised again.
    again = Bowl()
    found, notes = run_all(tmp_path / "fit", again, resume=True, breeds=Rounded, **ELSEWHERE)
    assert notes == []
    assert 20 + first.calls + again.calls == sum(len(run.best) for run in found)


def test_what_another_processor_breeds_otherwise_is_computed_again(tmp_path):
    interrupted(tmp_path / "fit", 33, **{PROCESSOR: "One 1"})
    states = [read_state(state_files(Checkpoint.folder_of(tmp_path / "fit"), run)[0])[0] for run in (1, 2)]
    kept = sum(min(5, len(stage.cost)) for memory in states for stage in memory.stages[:1])
    again = Bowl()
    found, _ = run_all(tmp_path / "fit", again, resume=True, breeds=Turned, **ELSEWHERE)
    assert kept + again.calls == sum(len(run.best) for run in found)
    assert sum(run.evaluations for run in found) == sum(
        40 * len(run.stages[0].cost) + 64 * len(run.stages[1].cost) for run in found
    )
    for run in found:
        # Every cost belongs to its point.
        for stage in run.stages:
            np.testing.assert_array_equal(Bowl().evaluate(stage.cube[-1]).cost, stage.cost[-1])


def test_costs_of_the_same_candidates_may_be_rounded_elsewhere_only(tmp_path):
    then = {PROCESSOR: "One 1", PROBES: [(0.1).hex(), (2.5).hex()]}
    near, far = [[(0.1 * (1 + d)).hex(), (2.5).hex()] for d in (1e-9, 1e-3)]
    interrupted(tmp_path / "fit", 20, **then)
    for now in ({**then, PROBES: near}, {**ELSEWHERE, PROBES: far}, {**ELSEWHERE, PROBES: None}):
        with pytest.raises(FitError, match=r"the cost of the same candidates .* differs"):
            Checkpoint(tmp_path / "fit", {**IDENTITY, **now}, resume=True)
    Checkpoint(tmp_path / "fit", {**IDENTITY, **ELSEWHERE, PROBES: near}, resume=True).close()


def test_neither_overwritten_nor_resumed_by_accident(tmp_path):
    with pytest.raises(FitError, match="holds nothing to continue"):
        Checkpoint(tmp_path / "fit", IDENTITY, resume=True)
    assert list(tmp_path.iterdir()) == []
    interrupted(tmp_path / "fit", 20)
    with pytest.raises(FitError, match="unfinished fit is there; continue it with --resume"):
        Checkpoint(tmp_path / "fit", IDENTITY)
    Checkpoint(tmp_path / "fit", IDENTITY, force=True).close()
    assert list(tmp_path.iterdir()) == []


def test_full_disk_is_said_and_the_last_state_is_intact(tmp_path, monkeypatch, whole):
    hold = Checkpoint(tmp_path / "fit", IDENTITY)
    calls = []

    def keep(run, memory, ended):
        calls.append(run)
        if len(calls) == 40:

            def full(*_):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

            monkeypatch.setattr(os, "fsync", full)
        hold.keep(run, memory, ended)

    with pytest.raises(FitError, match=r"No space left on device.*continue the fit with --resume"):
        run_many(Bowl(), SETTINGS, hooks=Hooks(keep=keep))
    hold.close()
    monkeypatch.undo()
    found, notes = run_all(tmp_path / "fit", resume=True)
    assert_same(found, whole)
    assert notes == []


if sys.platform != "win32":  # which has no such limit

    def test_a_state_that_the_system_refuses_to_write_leaves_the_last_one(tmp_path, whole):
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
        assert_same(found, whole)
        assert notes == []


class Clock:
    """Time that passes only where a test lets it."""

    def __init__(self):
        self.now = 100.0

    def perf_counter(self):
        return self.now

    monotonic = perf_counter


@pytest.mark.parametrize("generation", [0.05, 0.3, 0.7, 0.99, 1.2, 1.4, 1.9, 2.5, 7.0])
def test_no_state_is_older_than_two_seconds(tmp_path, monkeypatch, generation):
    """From the run's begin on, for generations of any length [s]; every write takes 0.05 s of them."""
    clock, written = Clock(), []
    monkeypatch.setattr(checkpoint_module, "time", clock)
    monkeypatch.setattr(engine_module, "time", clock)
    real = checkpoint_module.write_file

    def write(*arguments):
        clock.now += 0.05
        real(*arguments)
        written.append(clock.now)

    monkeypatch.setattr(checkpoint_module, "write_file", write)

    class Slow(Bowl):
        def evaluate(self, cube):
            clock.now += len(cube) * generation / 40
            return super().evaluate(cube)

    hold, begun = Checkpoint(tmp_path / "fit", IDENTITY), clock.now
    settings = SearchSettings(40, 1, 5, StopRule(max_generations=9), "ga", "cmaes")
    (run,) = run_many(Slow(), settings, hooks=Hooks(keep=hold.keep), candidate_time=generation / 40)
    hold.discard()
    gaps = np.diff([begun, *written])
    assert gaps.max() <= 2.0
    # Both stages' ends are written, and nothing is written without need.
    assert written[-1] == clock.now
    assert len(written) <= 2 + (clock.now - begun) / min(0.5, checkpoint_module.INTERVAL)
    # How a generation is cut changes no bit.
    assert_same_run(run, run_many(Bowl(), settings)[0])


class Killed(Bowl):
    """Counts its candidates; dies at one of its calls."""

    def __init__(self, last=None):
        super().__init__()
        self.last, self.scored = last, 0

    def evaluate(self, cube):
        if self.calls == self.last:
            raise KeyboardInterrupt
        self.scored += len(cube)
        return super().evaluate(cube)


# A run has 14 generations of 40 candidates in 3 parts and 14 of 64 in 5.
@pytest.mark.parametrize("calls", [1, 2, 5, 44, 111, 335])
def test_a_generation_under_way_is_continued(tmp_path, monkeypatch, whole, calls):
    """What was scored of the generation in which a fit was killed is not scored again."""
    monkeypatch.setattr(checkpoint_module, "INTERVAL", 0.0)
    monkeypatch.setattr(checkpoint_module, "_LONGEST_INTERVAL", 0.0)
    monkeypatch.setattr(engine_module._Run, "_part", lambda run, left: min(left, 15))
    first, again = Killed(calls), Killed()
    with pytest.raises(KeyboardInterrupt):
        run_all(tmp_path / "fit", first, done=False)
    found, notes = run_all(tmp_path / "fit", again, resume=True)
    assert notes == []
    assert_same(found, whole)
    assert first.scored + again.scored == sum(run.evaluations for run in whole)


def started(fit, how):
    command = [sys.executable, "-m", "fakes.slow_fit", str(fit), how]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout.readline().strip() == b"begun"
    return process


def killed_and_resumed(tmp_path, whole, moments, draw):
    """Kill a fit at random moments one after the other; then finish it."""
    fit = tmp_path / "fit"
    for _ in range(moments):
        how = "resume" if run_numbers(Checkpoint.folder_of(fit)) else "start"
        process = started(fit, how)
        time.sleep(draw.uniform(0.0, 0.25))
        process.kill()
        process.wait()
        process.stdout.close()
    resume = bool(run_numbers(Checkpoint.folder_of(fit)))
    found, notes = run_all(fit, resume=resume)
    assert_same(found, whole)
    # Even a kill inside a write damages nothing.
    assert notes == []


def test_killed_at_random_moments(tmp_path, whole):
    killed_and_resumed(tmp_path, whole, 3, random.Random(1))


@pytest.mark.slow
def test_killed_at_thirty_random_moments(tmp_path, whole):
    draw = random.Random(2)
    for number in range(6):
        killed_and_resumed(tmp_path / str(number), whole, 5, draw)


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


def test_interrupt_keeps_a_state(tmp_path, whole):
    flag = StopFlag()

    class Stopping(Bowl):
        def evaluate(self, cube):
            if self.calls == 9:
                flag.set()
            return super().evaluate(cube)

    (first,), _ = run_all(tmp_path / "fit", Stopping(), flag=flag, done=False)
    assert first.stop_reason == "interrupted"
    found, _ = run_all(tmp_path / "fit", resume=True)
    assert_same(found, whole)


def test_memory_survives_the_file_exactly(tmp_path):
    memory = RunMemory(7)
    stage = memory.stage(0, "ga")
    costs = np.array([0.1 + 2**-54, np.nextafter(0.3, 1), 1e300])
    stage.append(np.zeros((3, 2)), Evaluation(costs, np.array([True, False, False]), 18), 0.25)
    data = checkpoint_module.state_bytes(memory, {})
    (tmp_path / "state").write_bytes(data)
    again, _ = read_state(tmp_path / "state")
    np.testing.assert_array_equal(again.stages[0].cost[0], costs)
    assert (again.stages[0].failed, again.stages[0].simulations) == ([1], [18])
    assert again.stages[0].asked == stage.asked
    assert again.stages[0].ended is None
