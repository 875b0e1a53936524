"""What tests share: the command line, and two threads also on one core, as many compare one with two."""

import os

import pytest

if int(os.environ.get("NUMBA_NUM_THREADS") or os.cpu_count() or 1) < 2:
    # Numba reads it when it is first imported.
    os.environ["NUMBA_NUM_THREADS"] = "2"


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
