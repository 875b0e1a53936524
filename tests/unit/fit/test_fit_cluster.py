"""The executor: the same bits from this process and from a real Dask cluster that loses a worker."""

import json
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes.bowl import Bowl, Decay, assert_same_runs
from fakes.places import SAMPLES
from sysid import parallel
from sysid.campaign import read_campaign
from sysid.errors import SysidError
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.problem import computed_by
from sysid.fit.search import Hooks, run_many
from sysid.fit.settings import SearchSettings
from sysid.gear.drops import prepare_drops
from sysid.gear.problem import GearProblem, gear_space
from sysid.journal import Journal
from sysid.parallel import (
    ClosedError,
    ClusterError,
    DaskCluster,
    LocalThreads,
    chunk_size,
    executor,
    threads_for,
)

HERE = str(Path(__file__).parent)
SETTINGS = SearchSettings(40, 3, 5, 10, "ga", "cmaes")


@pytest.fixture(scope="module")
def gear():
    """The objective of the sample drops, on one core."""
    path = SAMPLES / "gear-lf" / "campaign.toml"
    campaign = read_campaign(path, "gear")
    drops = tuple(drop for drop in prepare_drops(campaign, path) if drop.use == "fit")
    return GearProblem(campaign, gear_space(campaign), drops, threads=1)


@contextmanager
def cluster(folder, workers):
    """A scheduler and worker processes, as a lab starts them by hand."""
    pytest.importorskip("distributed", reason="Dask comes with the extra 'cluster'")
    file = folder / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([HERE, os.environ["PYTHONPATH"]])}
    quiet = ["--no-nanny", "--no-dashboard", "--local-directory", str(folder)]
    common = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    dask = [sys.executable, "-m", "dask"]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--port", "0", "--scheduler-file", str(file), "--no-dashboard"], **common
    )
    processes = [scheduler]
    try:
        deadline = time.monotonic() + 30
        # The scheduler opens its file before it writes it: an empty file is not ready.
        while not (file.is_file() and file.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.05)
        for _ in range(workers):
            processes.append(
                subprocess.Popen(
                    [*dask, "worker", "--scheduler-file", str(file), "--nthreads", "1", *quiet], **common
                )
            )
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        with DaskCluster(address, at_once=3) as found:
            found._client.wait_for_workers(workers, timeout=60)
            yield found, processes
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


class Slow(Bowl):
    """Slow enough to be killed in the middle of a generation."""

    def evaluate(self, cube):
        time.sleep(0.002 * len(cube))
        return super().evaluate(cube)


def test_chunks_do_not_change_a_bit(gear):
    points = np.random.default_rng(3).random((37, len(gear.space.free)))
    whole = gear.evaluate(points)
    for size in (1, 5, 16):
        parts = [gear.evaluate(points[i : i + size]) for i in range(0, 37, size)]
        np.testing.assert_array_equal(np.concatenate([p.cost for p in parts]), whole.cost)
        np.testing.assert_array_equal(np.concatenate([p.failed for p in parts]), whole.failed)
        assert sum(p.simulations for p in parts) == whole.simulations


def test_local_gives_the_objectives_numbers(gear):
    points = np.random.default_rng(3).random((9, len(gear.space.free)))
    with executor(None) as where:
        assert isinstance(where, LocalThreads)
        spread = computed_by(gear, where)
        assert spread.space is gear.space
        a, b = spread.evaluate(points), gear.evaluate(points)
    np.testing.assert_array_equal(a.cost, b.cost)
    np.testing.assert_array_equal(a.failed, b.failed)
    assert a.simulations == b.simulations


def test_local_work_is_entered_by_two_callers_at_a_time():
    inside, most = [], []

    def work(rows):
        inside.append(1)
        most.append(len(inside))
        time.sleep(0.005)
        inside.pop()
        return (rows[:, 0],)

    both = threading.Barrier(2)

    def cores(rows):
        both.wait(timeout=10)
        threads = threads_for(100, 4)
        both.wait(timeout=10)
        return (np.full(len(rows), threads),)

    with LocalThreads(4) as where, ThreadPoolExecutor(4) as pool:
        # Callers leave each other a share of the cores.
        (first,), (second,) = pool.map(where.share(cores), np.zeros((2, 1, 1)))
        assert (first, second, threads_for(100, 4)) == (2, 2, 4)
        # One core is for one caller.
        with LocalThreads(1) as alone:
            shared = alone.share(work)
            list(pool.map(lambda i: shared(np.full((2, 1), float(i))), range(4)))
        assert max(most) == 1
        most.clear()
        shared = (where.share(work), where.share(work))
        out = list(pool.map(lambda i: shared[i % 2](np.full((2, 1), float(i))), range(8)))
    assert max(most) == 2
    assert [float(column[0]) for (column,) in out] == list(range(8))
    # A run that has been called off may still ask.
    with pytest.raises(ClosedError):
        shared[0](np.zeros((2, 1)))
    assert len(most) == 8


@pytest.mark.parametrize(
    ("rows", "callers", "workers", "per_row", "expected"),
    [
        (800, 5, 64, 1e-3, 60),  # many workers: 0.06 s
        (800, 5, 64, 1e-2, 25),  # half of a worker's 63 would take 0.3 s
        (800, 1, 64, 1e-3, 13),  # the last run: all workers get some
        (100, 5, 2, 1e-3, 100),  # two workers, five runs: a generation is one chunk
        (100, 1, 2, 1e-3, 50),  # the last run is shared between both
        (100, 5, 2, 1.0, 8),  # slow: the lanes of a core are full
        (100, 5, 2, None, 16),
        (3, 1, 2, 1e-3, 2),
        (1, 1, 64, 0.0, 1),
    ],
)
def test_chunks_are_sized_by_measured_time(rows, callers, workers, per_row, expected):
    assert chunk_size(rows, callers, workers, per_row) == expected


def test_nothing_answers():
    pytest.importorskip("distributed", reason="Dask comes with the extra 'cluster'")
    with pytest.raises(ClusterError, match=r"no Dask scheduler answers at 'nonsense://x'"):
        DaskCluster("nonsense://x")


def test_a_scheduler_without_workers_is_said_and_then_refused(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(parallel, "SAID_AFTER", 0.5)
    monkeypatch.setattr(parallel, "PATIENCE", 1.5)
    said = []
    words = r"has had no worker for 2 s; start one with 'dask worker tcp:"
    with pytest.raises(ClusterError, match=words), Journal(said.append), cluster(tmp_path, 0):
        pass
    assert len(said) == 1
    assert "has no worker; waiting up to 1 s more; start one with 'dask worker tcp:" in said[0]
    # The libraries add nothing of their own.
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_local_workers_listen_on_this_machine_only():
    psutil = pytest.importorskip("psutil", reason="comes with the extra 'cluster'")
    with executor("local") as where:
        np.testing.assert_array_equal(where.share(lambda rows: (rows[:, 0],))(np.ones((3, 2)))[0], np.ones(3))
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        listening = [c.laddr.ip for p in processes for c in p.net_connections() if c.status == "LISTEN"]
    # The scheduler's, and those of each worker.
    assert len(listening) > (os.cpu_count() or 1)
    assert set(listening) <= {"127.0.0.1", "::1"}


@pytest.mark.slow
def test_three_workers_give_the_local_numbers_and_one_may_be_killed(tmp_path, gear):
    short = replace(SETTINGS, max_generations=5)
    local = run_many(gear, short)
    with cluster(tmp_path, 3) as (where, processes):
        spread = computed_by(gear, where)
        assert_same_runs(run_many(spread, short, at_once=3), local)
        victims, begun = [processes[1]], where.alive

        def kill(run, generation):
            # The two other runs are in the middle of a generation.
            if victims and generation.number == 3:
                victims.pop().kill()

        killed = run_many(spread, short, at_once=3, hooks=Hooks(on_generation=kill))
        assert victims == []
        assert processes[1].wait(10) != 0
        assert (begun, where.alive) == (3, 2)
        assert_same_runs(killed, local)


def test_least_squares_on_a_cluster_gives_the_same_numbers(tmp_path):
    settings = SearchSettings(40, 2, 5)
    with cluster(tmp_path, 2) as (where, _):
        found = run_many(computed_by(Decay(), where), settings, at_once=2)
    assert_same_runs(found, run_many(Decay(), settings))
    assert all([s.algorithm for s in run.stages] == ["ga", "least-squares"] for run in found)


@pytest.mark.slow
def test_a_lost_scheduler_leaves_a_checkpoint_to_continue_from(tmp_path):
    identity = {"the seed": SETTINGS.seed}
    hold = Checkpoint(tmp_path / "fit", identity)

    with cluster(tmp_path, 2) as (where, processes):
        spread = computed_by(Slow(), where)

        def kill(run, generation):
            if run == 0 and (generation.algorithm, generation.number) == ("cmaes", 2):
                processes[0].kill()

        with pytest.raises(SysidError, match=r"lost the work .*--resume"):
            run_many(spread, SETTINGS, checkpoint=hold, at_once=3, hooks=Hooks(on_generation=kill))
    hold.close()

    again = Checkpoint(tmp_path / "fit", identity, resume=True)
    assert again.finished(0, 0, "ga", 3) is not None
    bowl = Bowl()
    found, whole = run_many(bowl, SETTINGS, checkpoint=again), run_many(Bowl(), SETTINGS)
    assert again.notes == []
    again.discard()
    assert_same_runs(found, whole)
    # A stage that has ended on the cluster is not computed again.
    assert bowl.calls <= sum(len(run.best) for run in whole) - 10
