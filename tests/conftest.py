"""What tests share: the command line and small logs."""

import os
import shutil
import signal
from pathlib import Path

import pytest

import sysid  # noqa: F401  one thread of BLAS, so that bits do not depend on the number of cores
from fakes.places import SAMPLES

# Processes that a test starts find `fakes` and this checkout as the test itself does.
_TESTS = Path(__file__).resolve().parent
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(_TESTS.parent), str(_TESTS), *filter(None, [os.environ.get("PYTHONPATH")])]
)

# A shell starts what runs in its background with Ctrl-C ignored; its tests need it as on a terminal.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Folders and files that take longest, in the fast suite or in the slow one.
_LONG = {
    "recovery", "golden", "test_readme.py", "test_notebooks.py", "test_mutations.py", "test_faults.py",
    "test_fit_command.py", "test_fit_motor_command.py", "test_cli.py", "test_python.py",
    "test_gear_machine.py", "test_order_of_trials.py", "test_motor_real_logs.py", "test_fit_folder_states.py",
}  # fmt: skip


def pytest_collection_modifyitems(items):
    """Put what takes long first, so that two workers that share files end together."""
    items.sort(key=lambda item: not _LONG & {*item.path.parts})


@pytest.fixture
def run(monkeypatch, capsys):
    """The command line in this process: ``run("show", folder)`` returns exit code, output and errors."""
    from sysid import cli

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["sysid", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def refused(run):
    """A command that must be refused in one sentence with these words; returns what it says.

    ``refused("the seed differs", "fit-gear", file)``, or a sequence of words.
    """

    def call(words, *arguments):
        code, out, err = run(*arguments)
        assert code == 2, (out, err)
        sentences = [line for line in err.splitlines() if line.startswith("error: ")]
        assert len(sentences) == 1, err
        assert "Traceback" not in err
        for word in [words] if isinstance(words, str) else words:
            assert word in sentences[0]
        return err

    return call


@pytest.fixture
def write(tmp_path):
    """Write a file into the test's folder: ``write("a,b\\n1,2\\n", "log.csv")`` returns its path."""

    def call(content, name="log"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
        return path

    return call


@pytest.fixture
def drops(tmp_path, monkeypatch):
    """A copy of the sample drops on low friction; results go to a fits/ beside it."""
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops"))


@pytest.fixture
def in_this_process(monkeypatch):
    """Read foreign formats here: half a second less for each file in tests of what a reader reads."""
    from sysid.loaders import isolation, registry

    monkeypatch.setattr(registry, "isolated", isolation.read_here)


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the pictures of pages empty: drawing them takes seconds in tests of something else."""
    monkeypatch.setattr("sysid.report.html.figure_bytes", lambda *drawn: b"<svg/>")


@pytest.fixture
def unranked(monkeypatch):
    """Let a check rank no recordings to make next, which takes most of its time."""
    monkeypatch.setattr("sysid.workflows.check.rank_candidates", lambda *asked: [])
