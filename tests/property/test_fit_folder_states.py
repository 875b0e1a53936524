"""Commands on one fit folder in any order: each ends as the manual says, and no order changes a number.

The kind is a lag of two parameters, whose fits take half a second; its folder is written and read by the code
of a motor's and a gear's. `fit-motor` fits it here, so that every command passes the command line.
"""

import json
import shutil
import signal
from functools import cache

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from fakes.lag_kind import write_lag
from sysid.fit import checkpoint
from sysid.fit.store import read_fit
from sysid.own import OwnProblem
from sysid.trust.documents import TrustDocument, parts
from sysid.workflows import fit as workflow

SEARCH = "runs = 2\npopulation = 8\nmax_generations = 3\n"
SEEDS = (0, 1)
# Simulations after which Ctrl-C comes; a fit with intervals has some 120.
STOPS = st.sampled_from([None, None, None, None, 3, 10, 20, 40, 70])
# Codes of README: done, refused, flagged, stopped, closed pipe.
CODES = {0, 2, 3, 130, 141}


def numbers(fit):
    """The bits of a fit, but for its times."""
    stages = [stage for run in fit.runs for stage in run.stages]
    found = [stage.cube.tobytes() + stage.cost.tobytes() for stage in stages]
    return [
        fit.values.tobytes(),
        fit.nrmse.tobytes(),
        *(trial.simulated.tobytes() for trial in fit.trials),
        *found,
    ]


def intervals(document):
    return [(row.name, row.interval_95, row.open_95, row.refined) for row in document.parameters]


class Lab:
    """Campaigns, their straight runs, and commands that stop where a test asks for it."""

    def __init__(self, folder, run, monkeypatch):
        self.folder, self.command, self.count = folder, run, 0
        monkeypatch.setattr(workflow, "fit_motor", workflow.fit_campaign)
        monkeypatch.setattr(checkpoint, "INTERVAL", 0.0)
        monkeypatch.setattr(OwnProblem, "predict", self._counted(OwnProblem.predict))
        self.left = None
        source = write_lag(self.make("source"), SEARCH)
        text = source.read_text(encoding="utf-8")
        # The second campaign holds no trial back.
        self.logs, self.texts = source.parent, (text, text.replace('use = "validate"', 'use = "fit"'))

    @cache  # noqa: B019  the fixture ends with its test
    def straight(self, text, seed):
        """Return numbers and intervals of a fit that nothing has stopped."""
        home = self.home(text)
        assert self.run("fit-motor", home / "lag.toml", "--out", home / "fit", "--seed", seed)[0] == 0
        return numbers(read_fit(home / "fit")), intervals(TrustDocument.read(home / "fit"))

    def make(self, name):
        self.count += 1
        folder = self.folder / f"{name}-{self.count}"
        folder.mkdir()
        return folder

    def home(self, text):
        folder = self.make("home")
        for log in self.logs.glob("*.csv"):
            shutil.copy(log, folder)
        (folder / "lag.toml").write_text(text, encoding="utf-8")
        return folder

    def _counted(self, real):
        def predict(problem, rows):
            if self.left is not None:
                self.left -= 1
                if self.left == 0:
                    signal.raise_signal(signal.SIGINT)
            return real(problem, rows)

        return predict

    def run(self, *arguments, stop=None):
        """Return exit code, output and errors of a command that hears Ctrl-C at its `stop`-th simulation."""
        self.left = stop
        try:
            return self.command(*arguments)
        finally:
            self.left = None


def tree(folder):
    """The bytes of every file below a folder by its place."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def fitted(machine):
    return (machine.fit / "fit.h5").is_file()


def machine(lab):
    """Return the class of a machine whose commands work on a folder of their own."""

    class OneFolder(RuleBasedStateMachine):
        def __init__(self):
            super().__init__()
            self.home = lab.home(lab.texts[0])
            self.campaign, self.fit = self.home / "lag.toml", self.home / "fit"

        def teardown(self):
            shutil.rmtree(self.home)

        def run(self, *arguments, stop=None):
            before = tree(self.home)
            code, _, said = lab.run(*arguments, stop=stop)
            assert code in CODES, (arguments, code, said)
            assert "Traceback" not in said, said
            assert said.count("error: ") == (code == 2), said
            if code == 2:
                assert tree(self.home) == before, (arguments, said)
            return code

        @rule(
            seed=st.sampled_from(SEEDS), how=st.sampled_from(["", "--force", "--force", "--resume"]),
            trust=st.booleans(), stop=STOPS,
        )  # fmt: skip
        def fits(self, seed, how, trust, stop):
            more = [*filter(None, [how]), "--trust" if trust else "--no-trust"]
            self.run("fit-motor", self.campaign, "--out", self.fit, "--seed", seed, *more, stop=stop)

        @precondition(fitted)
        @rule(stop=STOPS)
        def trusts(self, stop):
            self.run("trust", self.fit, "--resamples", "0", stop=stop)

        @precondition(fitted)
        @rule(command=st.sampled_from(["cross-validate", "explain", "show", "fits", "check", "compare"]))
        def reads(self, command):
            of = {"fits": (self.home,), "check": (self.campaign,), "compare": (self.fit, self.fit)}
            self.run(command, *of.get(command, (self.fit,)))

        @precondition(fitted)
        @rule()
        def validates(self):
            self.run("validate", self.fit, self.campaign)

        @precondition(fitted)
        @rule(force=st.booleans())
        def reports(self, force):
            self.run("report", self.fit, *["--force"] * force)

        @precondition(fitted)
        @rule(suffix=st.sampled_from(["json", "csv", "h5", "mat"]), force=st.booleans())
        def exports(self, suffix, force):
            self.run("export", self.fit, "--out", self.home / f"sets.{suffix}", *["--force"] * force)

        @rule(text=st.sampled_from([0, 1]))
        def edits_the_campaign(self, text):
            self.campaign.write_text(lab.texts[text], encoding="utf-8")

        @precondition(fitted)
        @rule(number=st.integers(0, 30))
        def deletes_a_part(self, number):
            there = [path for path in tree(self.home) if len(path.parts) > 1]
            if there:
                (self.home / sorted(there)[number % len(there)]).unlink()

        @precondition(lambda self: self.fit.is_dir() and not fitted(self))
        @rule()
        def deletes_all(self):
            for folder in filter(lambda path: path.is_dir(), list(self.home.iterdir())):
                shutil.rmtree(folder)

        @invariant()
        def nothing_is_half_written(self):
            assert not [path for path in tree(self.home) if path.name.endswith(".part")]
            for path in self.home.rglob("*.json"):
                json.loads(path.read_text(encoding="utf-8"))

        @invariant()
        def numbers_are_those_of_the_straight_run(self):
            if not (self.fit / "fit.h5").is_file():
                return
            fit = read_fit(self.fit)
            campaign = fit.provenance["campaign"]
            if fit.state == "done":
                # A command that is stopped early leaves the fit of the one before.
                found, judged = lab.straight(campaign["text"], fit.provenance["search"]["seed"])
                assert numbers(fit) == found
                document = TrustDocument.read(self.fit) if "trust" in parts(self.fit) else None
                if document is not None and document.campaign["sha256"] == campaign["sha256"]:
                    assert intervals(document) == judged

    return OneFolder


def bench(lab, examples, steps):
    run_state_machine_as_test(
        machine(lab),
        settings=settings(
            max_examples=examples, stateful_step_count=steps, deadline=None, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck), phases=[Phase.generate],
        ),
    )  # fmt: skip


@pytest.fixture
def lab(tmp_path, run, monkeypatch, undrawn):
    return Lab(tmp_path, run, monkeypatch)


def test_sixty_steps_on_fit_folders(lab):
    bench(lab, 4, 15)


@pytest.mark.slow
def test_six_hundred_steps_on_fit_folders(lab):
    bench(lab, 15, 40)
