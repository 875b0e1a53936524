"""On a terminal of 40 columns no line of results or refusals is longer than the terminal."""

import fcntl
import os
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

import sysid
from fakes.lag_kind import write_lag

COLUMNS = 40
# All commands in one process, whose kind of model the test declares.
PROGRAM = f"""
import json, sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
import fakes.lag_kind
from sysid import cli
for words in json.loads(sys.argv[1]):
    sys.argv = ["sysid", *words]
    print("== " + words[0], flush=True)
    try:
        cli.main()
    except SystemExit as stop:
        print("code", stop.code, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_lines_end_before_the_terminal_does(tmp_path):
    write_lag(tmp_path)
    sysid.fit_campaign(tmp_path / "lag.toml", tmp_path / "fit", runs=2, population=16, max_generations=10)
    commands = (
        '[["show", "fit"], ["fits", "."], ["check", "lag.toml"], ["trust", "fit"], ["report", "m.h5"],'
        '["fit", "lag.toml", "--runs", "1", "--population", "16", "--out", "again"]]'
    )
    outer, inner = os.openpty()
    fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", 40, COLUMNS, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "CI")}
    child = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, commands], cwd=tmp_path, stdin=inner, stdout=inner, stderr=inner,
        env=environment | {"TERM": "xterm"},
    )  # fmt: skip
    os.close(inner)
    shown = b""
    while part := _read(outer):
        shown += part
    os.close(outer)
    assert child.wait() == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode("utf-8")).replace("\r\n", "\n")
    assert re.findall(r"code (\d+)", text) == ["0", "0", "0", "0", "2", "0"], text
    # What a live block draws over itself begins with a carriage return.
    lines = [line for whole in text.split("\n") for line in whole.split("\r")]
    assert not [line for line in lines if len(line) > COLUMNS]
    # The refusal names the file that is not there, between words.
    assert "error: m.h5: is not there; expected" in " ".join(text.split())


def _read(terminal):
    try:
        return os.read(terminal, 65536)
    except OSError:  # the end, on Linux
        return b""
