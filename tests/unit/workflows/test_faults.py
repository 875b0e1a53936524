"""The disk fails at any write: the result is the old one or the new one, and --resume gives equal bits."""

import json
import shutil
from contextlib import suppress
from importlib.metadata import version

import numpy as np
import pytest

from fakes.faults import KINDS, Disk, Killed, faulty
from fakes.lag_kind import write_lag
from sysid.errors import ExportError, FitError, SysidError
from sysid.fit import checkpoint
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.store import read_fit
from sysid.resume import BlockStore
from sysid.storage import FileKind, write_file
from sysid.trust.documents import TRUST, TrustDocument, read_arrays
from sysid.workflows import fit as workflow
from sysid.workflows import provenance
from sysid.workflows.fit import fit_campaign
from sysid.workflows.landing_sources import compute_and_write
from sysid.workflows.options import ComputeOptions, FitOptions
from sysid.workflows.trust import assess_opened

QUICK = {"quiet": True, "check": False, "trust": False}
# A dozen operations per state; the fault of every operation is another test in the slow suite.
SEARCH = "runs = 2\npopulation = 8\nmax_generations = 2\nfinish = 'none'\n"


def numbers(folder):
    """The bits of a fit."""
    fit = read_fit(folder)
    stages = [stage for run in fit.runs for stage in run.stages]
    return [fit.values.tobytes(), fit.nrmse.tobytes(), *(s.cube.tobytes() + s.cost.tobytes() for s in stages)]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign, a fit of another seed that is to be replaced, and the fit that replaces it."""
    folder = tmp_path_factory.mktemp("faults")
    path = write_lag(folder, SEARCH)
    old = fit_campaign(path, FitOptions(out=folder / "old", seed=2, **QUICK))[1]
    new = fit_campaign(path, FitOptions(out=folder / "new", **QUICK))[1]
    return path, old, new


@pytest.fixture
def replaced(campaign, tmp_path, monkeypatch):
    """Return a function that replaces a fit on a disk, and returns what stopped it, if anything did."""
    monkeypatch.setattr(checkpoint, "INTERVAL", 0.0)
    path, old, _ = campaign

    def run(disk):
        out = tmp_path / "fit"
        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
        shutil.copytree(old, out)
        with faulty(monkeypatch, disk):
            try:
                fit_campaign(path, FitOptions(out=out, force=True, **QUICK))
            except (SysidError, Killed) as error:
                return out, error
        return out, None

    return run


def resumed(campaign, out):
    """Continue a fit, or begin it again where no state is left, and check its bits."""
    path, _, new = campaign
    resume = Checkpoint.kept(Checkpoint.folder_of(out))
    options = FitOptions(out=out, resume=resume, force=not resume, **QUICK)
    fit_campaign(path, options)
    assert numbers(out) == numbers(new)
    # Nothing unfinished is left behind.
    assert not Checkpoint.folder_of(out).exists()


def survives(campaign, replaced, at, kind):
    disk = Disk(at, kind)
    out, error = replaced(disk)
    what = (at, kind, disk.names[at], error)
    assert error is None or isinstance(error, Killed) == (kind == "killed"), what
    _, old, new = campaign
    if kind == "killed" and not out.exists():
        # Between two renames: the old fit is whole under a name that tells it.
        (aside,) = out.parent.glob(".fit.old.*.part/fit")
        shutil.copytree(aside, out)
    assert numbers(out) in (numbers(old), numbers(new)), what
    if error is None:
        assert numbers(out) == numbers(new), what
    if kind != "killed":
        # What failed is cleaned up: only a kill leaves temporary files.
        assert {path.name for path in out.parent.iterdir()} <= {"fit", "fit.checkpoint"}, what
    resumed(campaign, out)


def operations(replaced):
    disk = Disk()
    replaced(disk)
    return disk.names


def test_every_kind_of_write_of_a_fit_may_fail(campaign, replaced):
    names = operations(replaced)
    assert {"write", "fsync", "replace", "mkstemp", "mkdtemp", "chmod", "unlink", "rmdir"} <= set(names)
    # After the last rename the disk keeps the folder's names.
    assert "fsync" in names[-names[::-1].index("replace") :]
    # The last operation of each kind: those of the result.
    for number, name in enumerate(sorted(set(names))):
        survives(campaign, replaced, len(names) - 1 - names[::-1].index(name), KINDS[number % len(KINDS)])


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_write_of_a_fit_may_fail(campaign, replaced, kind):
    for at in range(len(operations(replaced))):
        survives(campaign, replaced, at, kind)


# --- the intervals at the end of a fit ----------------------------------------------------------------------


def texts(out):
    """The sets and the intervals of a fit as text, without clocks; None where it has no intervals."""
    document = TrustDocument.read(out)
    trust = document and document.model_dump(include={"parameters", "correlation", "noise", "trials"})
    arrays = document and {name: data.tobytes() for name, data in read_arrays(out, TRUST).items()}
    stated = json.loads((out / "fit.json").read_text(encoding="utf-8"))["settings"].get("intervals")
    summary = " 95 % " in (out / "summary.txt").read_text(encoding="utf-8")
    return repr(trust), repr(arrays), repr(stated), repr(summary), repr(numbers(out))


@pytest.mark.parametrize("kind", KINDS)
def test_every_write_of_a_fit_with_intervals_may_fail(campaign, tmp_path, monkeypatch, kind):
    """After each fault there is no fit or all of it with its intervals, and --resume gives all."""
    path = campaign[0]
    search = {"quiet": True, "check": False, "threads": 1}
    fit_campaign(path, FitOptions(out=tmp_path / "whole", **search))
    complete = texts(tmp_path / "whole")
    out = tmp_path / "fit"
    counted = Disk()
    begun = []

    def assessed(*arguments):
        begun.append(counted.count)
        return assess_opened(*arguments)

    monkeypatch.setattr(workflow, "assess_opened", assessed)
    with faulty(monkeypatch, counted):
        fit_campaign(path, FitOptions(out=out, **search))
    assert {"mkdtemp", "write", "chmod", "replace"} <= set(counted.names[begun[0] :])
    for at in range(begun[0], counted.count):
        shutil.rmtree(out, ignore_errors=True)
        broken = Disk(at, kind)
        with faulty(monkeypatch, broken), suppress(Killed, SysidError):
            fit_campaign(path, FitOptions(out=out, **search))
        what = (at - begun[0], kind, broken.names[at])
        assert not out.exists() or texts(out) == complete, what
        if Checkpoint.kept(Checkpoint.folder_of(out)):
            fit_campaign(path, FitOptions(out=out, resume=True, **search))
        assert texts(out) == complete, what
        shutil.rmtree(Checkpoint.folder_of(out), ignore_errors=True)


def test_a_fault_in_the_intervals_leaves_a_whole_fit_which_only_the_same_libraries_continue(
    campaign, tmp_path, monkeypatch
):
    def full(*_):
        raise MemoryError

    out, search = tmp_path / "fit", {"quiet": True, "check": False}
    with monkeypatch.context() as patched:
        patched.setattr(workflow, "assess_opened", full)
        with pytest.raises(MemoryError):
            fit_campaign(campaign[0], FitOptions(out=out, **search))
    assert numbers(out) == numbers(campaign[2])
    assert TrustDocument.read(out) is None
    for name in ("numpy", "scipy", "pymoo", "cma"):
        with monkeypatch.context() as patched:
            patched.setattr(provenance, "version", lambda of, name=name: "0.1" if of == name else version(of))
            with pytest.raises(FitError, match=rf"the version of {name} differs \(now 0\.1, then "):
                fit_campaign(campaign[0], FitOptions(out=out, resume=True, **search))
    fit_campaign(campaign[0], FitOptions(out=out, resume=True, **search))
    assert numbers(out) == numbers(campaign[2])
    assert TrustDocument.read(out) is not None


# --- maps and design studies --------------------------------------------------------------------------------

MADE = FileKind("sysid-made-map", 1, "a map", "compute it again", ExportError)
ROWS = {f"cell-{k}": np.arange(4.0 * k, 4.0 * k + 8).reshape(4, 2) for k in range(3)}


def mapped(out, monkeypatch, disk, **how):
    """Compute and write what a map and a design study do: blocks, an HDF5 file, a picture."""

    def write(columns):
        content = {name: np.stack(column) for name, column in sorted(columns.items())}
        write_file(out, MADE.content(lambda file: file.update(content)), ExportError)
        write_file(out.with_suffix(".png"), b"picture", ExportError)

    def compute(where):
        done = where.blocks(lambda rows: (np.sin(rows[:, 0]), rows.sum(axis=1)), ROWS)
        return done if len(done) == len(ROWS) else None

    with faulty(monkeypatch, disk):
        compute_and_write(
            out, {"seed": 1}, (len(ROWS), "cells"), compute, write, options=ComputeOptions(quiet=True, **how)
        )


@pytest.mark.parametrize("kind", KINDS)
def test_every_write_of_a_map_or_a_study_may_fail(tmp_path, monkeypatch, kind):
    disk = Disk()
    mapped(tmp_path / "whole.h5", monkeypatch, disk)
    whole = (tmp_path / "whole.h5").read_bytes()
    assert len(disk.names) > 20
    for at in range(len(disk.names)):
        folder = tmp_path / f"{kind}-{at}"
        folder.mkdir()
        out = folder / "map.h5"
        out.write_bytes(b"old")
        broken = Disk(at, kind)
        with suppress(SysidError, Killed):
            mapped(out, monkeypatch, broken, force=True)
        assert out.read_bytes() in (b"old", whole), (at, broken.names[at:])
        resume = BlockStore.kept(BlockStore.folder_of(out))
        mapped(out, monkeypatch, Disk(), force=True, resume=resume)
        assert out.read_bytes() == whole
        assert not BlockStore.folder_of(out).exists()
