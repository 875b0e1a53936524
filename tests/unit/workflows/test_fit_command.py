"""Unfinished fits on the command line: cut short, refused by accident, continued to the same numbers."""

import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from filelock import FileLock

from fakes.bowl import assert_same_runs
from sysid import exact_json
from sysid.campaign.common import FitTable
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.store import read_fit
from sysid.gear import kind
from sysid.gear import problem as gear
from sysid.parameters import ParameterTable
from sysid.search_options import DEFAULT_ALGORITHM, POPULATION
from sysid.stated import error_of
from sysid.workflows import fit as walk
from sysid.workflows.fits import list_fits
from sysid.workflows.options import FitOptions
from sysid.workflows.reopen import open_fit

SEARCH = ("--algorithm", "ga", "--population", "16", "--runs", "2", "--max-generations", "4")
SMALL = ("--no-trust", *SEARCH, "--quiet")


@pytest.fixture
def campaign(drops):
    """The sample campaign with two drops: to end and to continue a fit takes no more."""
    path = drops / "campaign.toml"
    path.write_text(
        "[[trials]]".join(path.read_text(encoding="utf-8").split("[[trials]]")[:3]), encoding="utf-8"
    )
    return path


@pytest.fixture
def cut(campaign, run):
    """The command of a fit that its time limit has cut, for `--resume`."""
    fit = ("fit-gear", campaign, *SMALL)
    assert run(*fit, "--time-limit", "0.001 s")[0] == 0
    return fit


def assert_same_fit(a, b):
    assert_same_runs(read_fit(a).runs, read_fit(b).runs)


def test_time_limit_then_resume_gives_the_uninterrupted_numbers(campaign, run, refused):
    assert run("fit-gear", campaign, *SMALL, "--out", "whole")[0] == 0
    assert not Path("whole.checkpoint").exists()
    whole = read_fit("whole")
    assert whole.state == "done"
    assert [s.algorithm for r in whole.runs for s in r.stages][:2] == ["ga", "least-squares"]

    fit = ("fit-gear", campaign, *SMALL, "--out", "cut")
    assert run(*fit, "--time-limit", "0.001 s")[0] == 0
    cut = read_fit("cut")
    assert cut.state == "stopped"
    assert {s.stop_reason for r in cut.runs for s in r.stages} == {"time"}
    assert len(cut.nrmse) == 2

    refused("unfinished fit is there; continue it with --resume, or discard it with --force", *fit)
    shown = run("fit-gear", campaign, *SMALL[:-1], "--out", "shown", "--time-limit", "0.001 s")[1]
    assert "verdict (with 0 of 2 runs finished): " in shown
    again = re.search(r"next:\n  sysid fit-gear (\S+) --out shown --resume --runs 2 ", shown)
    assert Path(again[1]).resolve() == Path(campaign).resolve()
    refused("the option seed differs (now 9, then 1)", *fit, "--resume", "--seed", "9")
    code, _, err = run(*fit, "--resume")
    assert code == 0, err
    assert read_fit("cut").state == "done"
    assert not Path("cut.checkpoint").exists()
    assert_same_fit("cut", "whole")
    refused("holds nothing to continue (the fit cut is finished); start", *fit, "--resume")


def test_fits_lists_states(campaign, run, refused):
    refused("fits: is not there; expected a folder that sysid fit-motor or fit-gear wrote", "fits")
    assert run("fit-gear", campaign, *SMALL, "--finish", "none", "--out", "fits/whole")[0] == 0
    cut = ("fit-gear", campaign, *SMALL, "--out", "fits/cut", "--time-limit", "0.001 s")
    assert run(*cut)[0] == 0
    for name in ("broken", "demo/motor"):
        Path("fits", name).mkdir(parents=True)
        Path("fits", name, "fit.h5").write_bytes(b"dust")
    found = {entry.name: entry for entry in list_fits("fits")}
    assert {name: entry.state for name, entry in found.items()} == {
        "broken": "damaged", "cut": "stopped", "demo/motor": "damaged", "whole": "cut",
    }  # fmt: skip
    assert found["whole"].nrmse == read_fit("fits/whole").nrmse[0]
    assert found["cut"].nrmse == read_fit("fits/cut").nrmse[0]
    # A fit of the same name is not to be continued or thrown away while it runs.
    with FileLock(Checkpoint.folder_of("fits/cut") / "lock"):
        assert {entry.name: entry.state for entry in list_fits("fits")}["cut"] == "running"
        for more in ((), ("--resume",), ("--force",)):
            refused("another process is working on this fit; wait for it", *cut, *more)
    code, out, _ = run("fits")
    assert code == 0
    assert "whole" in out
    assert "--resume" in out


def test_fits_of_a_lock_that_cannot_be_opened(cut, monkeypatch, run):
    """A folder in the lock's place, and a lock of somebody else: neither ends the list in a traceback."""
    folder = Checkpoint.folder_of(Path("fits") / "synthetic-lf")
    (folder / "lock").unlink(missing_ok=True)
    assert [entry.state for entry in list_fits("fits")] == ["stopped"]
    assert not (folder / "lock").exists()
    (folder / "lock").mkdir()
    code, out, err = run("fits")
    assert (code, err) == (0, "")
    assert "unfinished" in out
    (folder / "lock").rmdir()

    def refused(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    (folder / "lock").touch()
    monkeypatch.setattr(FileLock, "acquire", refused)
    assert [entry.state for entry in list_fits("fits")] == ["unfinished"]


def test_an_aborted_fit_says_how_it_goes_on(campaign, monkeypatch, run):
    """Aborted after its search: nothing is written, nothing is lost, and nobody is kept out."""

    def aborted(*arguments):
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    fit = ("fit-gear", campaign, *(word for word in SMALL if word != "--quiet"))
    with monkeypatch.context() as patched:
        patched.setattr(walk, "_result", aborted)
        code, _, err = run(*fit)
    assert code == 130
    folder = Path("fits") / "synthetic-lf"
    kept = f"{folder}: aborted; finished stages are kept, continue with --resume"
    assert err.endswith(f"{kept}\nstopped by the user\n")
    assert signal.getsignal(signal.SIGINT) is before
    assert not folder.exists()
    assert run(*fit, "--resume")[0] == 0
    assert read_fit(folder).state == "done"


@pytest.mark.parametrize(("module", "step"), [(kind, "prepare_drops"), (walk, "quick_expectations")])
def test_ctrl_c_before_the_search_ends_the_fit(module, step, campaign, monkeypatch, run):
    """At once; nothing is written."""

    def pressed(*arguments):
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("not heard")

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(module, step, pressed)
    assert run("fit-gear", campaign, *SMALL) == (130, "", "stopped by the user\n")
    assert not Path("fits").exists()
    assert signal.getsignal(signal.SIGINT) is before


def test_a_fit_whose_last_runs_were_not_begun_is_not_done(campaign, monkeypatch, run):
    real = walk.run_many
    with monkeypatch.context() as patched:
        patched.setattr(walk, "run_many", lambda *a, **more: real(*a, **more)[:1])
        code, _, _ = run("fit-gear", campaign, *SMALL, "--finish", "none")
    assert code == 130
    cut = read_fit(Path("fits") / "synthetic-lf")
    assert cut.state == "stopped"
    text = (Path("fits") / "synthetic-lf" / "summary.txt").read_text(encoding="utf-8")
    assert "1 of 2 runs was begun, none of them finished (generation limit)" in text
    assert any(warning.startswith("1 of 2 runs was begun") for warning in cut.warnings)


def test_the_record_says_what_was_run(campaign, run):
    assert run("fit-gear", campaign, *SMALL)[0] == 0
    folder = Path("fits") / "synthetic-lf"
    with h5py.File(folder / "fit.h5", "r") as file:
        record = exact_json.loads(file["record_json"].asstr()[()])
    runs = read_fit(folder).runs
    assert record["totals"]["candidates"] == sum(r.evaluations for r in runs)
    assert record["totals"]["simulations"] == 2 * record["totals"]["candidates"]
    assert [r["seed"] for r in record["runs"]] == [r.seed for r in runs] == record["search"]["run_seeds"]
    assert record["search"]["algorithm"] == "ga"
    assert set(record["libraries"]) >= {"numpy", "pymoo", "cma", "numba"}
    assert len(record["logs"]["drop-1"]["sha256"]) == 64
    assert record["processor"]
    text = (folder / "summary.txt").read_text(encoding="utf-8")
    for words in ("record", "git revision", "simulations per second", "sha256", "processor"):
        assert words in text


def test_another_fit_is_not_continued(cut, campaign, refused):
    for more, words in (
        (("--algorithm", "de"), "the option algorithm differs (now de, then ga)"),
        (("--finish", "none"), "the option finish differs (now none, then least-squares)"),
        (("--population", "24"), "the option population differs (now 24, then 16)"),
        (("--max-generations", "9"), "the option max generations differs (now 9, then 4)"),
        (("--exact",), "the option exact differs (now True, then False)"),
        (("--max-evaluations", "900"), "the option max evaluations of a run differs (now 450, then nothing)"),
        # Its low friction lies outside the bounds of high friction; it is left out there.
        (("--surface", "hf"), "the parameter table differs"),
    ):
        assert "restore it, or start again with --force" in refused(words, *cut, "--resume", *more)
    for path, text, words in (
        (campaign.parent / "drop-2-10deg-0.80mps.csv", b"\r\n", "log drop-2 differs"),
        (campaign, b"# measured again in March\n", "cannot be continued because the campaign file differs"),
    ):
        before = path.read_bytes()
        path.write_bytes(before + text)
        refused(words, *cut, "--resume")
        path.write_bytes(before)


def test_low_friction_drops_are_fitted_on_the_high_friction_law(campaign, run, refused):
    """The stated friction, outside the bounds that high friction has, is of the other surface."""
    fit = ("fit-gear", campaign, *SMALL[:-1], "--surface", "hf", "--max-generations", "1", "--finish", "none")
    fit += ("--exact",)
    code, _, err = run(*fit)
    assert code == 0, err
    line = "friction law hf: ignoring kinetic_friction, slip_regularization, which the campaign states for lf"
    assert " ".join(err.split()).count(line) == 1
    # What the fit took as exact is exact for all that opens it later.
    opened = open_fit(next(Path("fits").iterdir()))
    assert (opened.whole.campaign.fit.exact, error_of(opened.whole.campaign.trials[0].slope)) == (True, 0.0)
    words = f"{campaign}: surface: no friction law 'ice'; known are lf, hf"
    refused(words, "fit-gear", campaign, "--surface", "ice", "--force")


def test_another_parameter_table_or_accuracy_is_not_continued(cut, monkeypatch, refused):
    """Both count by themselves, not only as a line of the campaign file."""
    rows = gear.parameters_on("lf").values()
    wider = [replace(row, upper=2 * row.upper) if row.name == "ground_stiffness" else row for row in rows]
    with monkeypatch.context() as patched:
        patched.setattr(gear, "parameters_on", lambda *law: ParameterTable(wider))
        refused("cannot be continued because the parameter table differs", *cut, "--resume")
    monkeypatch.setattr(gear, "fit_tolerance", lambda campaign: 1e-4)
    refused("because the accuracy of a simulation differs (now 0.0001, then 0.0003)", *cut, "--resume")


def test_another_processor_is_noted(cut, monkeypatch, run):
    monkeypatch.setattr(walk, "processor", lambda: "Abacus 2")
    code, _, err = run(*cut, "--resume")
    assert code == 0, err
    fit = read_fit(Path("fits") / "synthetic-lf")
    assert fit.state == "done"
    (note,) = [warning for warning in fit.warnings if "begun on another processor" in warning]
    assert "this is Abacus 2" in note


def test_more_runs_keep_the_best_five(campaign, run):
    fit = ("fit-gear", campaign, *SMALL, "--finish", "none", "--runs", "7")
    code, _, err = run(*(word for word in fit if word != "--quiet"), "--details")
    assert code == 0
    found = read_fit(Path("fits") / "synthetic-lf")
    best = sorted(float(run.best[-1]) for run in found.runs)
    assert len(best) == 7
    assert found.nrmse.tolist() == best[:5]
    assert len(set(found.set_runs)) == 5
    # Four generations of sixteen finish nothing: seven rows of a table, and a sentence.
    assert "rank  run" in err
    assert "7 of 7 runs were not finished (generation limit)" in err
    assert any(warning.startswith("7 of 7 runs were not finished") for warning in found.warnings)


def test_population_follows_the_algorithm_where_none_is_named():
    def searched(table, **options):
        settings = FitOptions(**options).search(FitTable(**table))
        return settings.algorithm, settings.population

    assert searched({}) == (DEFAULT_ALGORITHM, POPULATION[DEFAULT_ALGORITHM])
    for algorithm, population in POPULATION.items():
        assert searched({}, algorithm=algorithm) == (algorithm, population)
        assert searched({"algorithm": algorithm}) == (algorithm, population)
    assert searched({"population": 70}, algorithm="de") == ("de", 70)
    assert searched({"population": 70}, algorithm="de", population=90) == ("de", 90)


NEW_OPTION = """
import importlib.util, sys
from pathlib import Path
found = importlib.util.find_spec("sysid.search_options")
text = Path(found.origin).read_text(encoding="utf-8")
line = '    tournament: Annotated[int, Flag("Rivals of a parent.", least=2)] = 2\\n'
before, head, after = text.partition('    stop_reading: Reading = "relative"\\n')
module = importlib.util.module_from_spec(found)
sys.modules[found.name] = module
exec(compile(before + line + head + after, found.origin, "exec"), vars(module))

from sysid.campaign import FitTable
from sysid.cli import main
from sysid.fit.provenance import SearchRecord
from sysid.workflows.options import FitOptions
assert FitOptions().search(FitTable(tournament=3)).tournament == 3
settings = FitOptions(tournament=4).search(FitTable(tournament=3))
assert settings.tournament == settings.continued_by()["tournament"] == vars(settings)["tournament"] == 4
assert SearchRecord.__annotations__["tournament"] is int
sys.argv[1:] = ["fit-motor", "--help"]
main()
"""


def test_an_option_of_the_search_is_declared_in_one_place():
    done = subprocess.run([sys.executable, "-c", NEW_OPTION], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "--tournament NUMBER" in done.stdout
    assert "Rivals of a parent." in done.stdout
