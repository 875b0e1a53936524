"""A process that opens damaged files under limits and says what came of each, and the handle to drive it.

Outcomes: ``equal`` (as before the damage), ``noted`` (differs, with a note that the whole file has not),
``local`` (only as many rows of a log differ as bytes or lines were damaged), ``refused`` in one sentence,
``silent`` (differs and says nothing); and what must not be: ``traceback``, ``hang``, ``memory``, ``crash``,
``words`` (no short sentence).
"""

import contextlib
import json
import os
import queue
import re
import subprocess
import sys
import threading
from pathlib import Path

# Time [s] and memory [bytes] that one load may take: the bench is of logs of some kilobytes. A foreign format
# has its own limit of 20 s.
SECONDS, BYTES, TIMES = 30.0, 1 << 30, 20
BAD = ("traceback", "hang", "memory", "crash", "words")
_LONGEST, _PROC = 1500, Path("/proc/self")
# Control characters, line ends and marks of direction.
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class Worker:
    """Handle of the process, which is started again after it died."""

    def __init__(self):
        self._process = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end()

    def _start(self):
        root = Path(__file__).parents[2]
        paths = os.pathsep.join([str(root), str(root / "tests"), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            stderr=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": paths}, encoding="utf-8",
        )  # fmt: skip
        self._answers = queue.Queue()
        threading.Thread(
            target=lambda out, into: [into.put(line) for line in out] + [into.put("")],
            args=(self._process.stdout, self._answers), daemon=True,
        ).start()  # fmt: skip
        assert self._answers.get(timeout=120) == "ready\n"

    def _end(self):
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def outcome(self, path, whole, form, options, damaged):
        """Return what came of loading the log `path`; it was `damaged` in so many bytes or lines."""
        return self.answer("log", path, whole, form=form, options=options, damaged=damaged)

    def answer(self, kind, path, whole, **more):
        """Return what came of opening `path` as {"outcome", "what"}; `whole` is the same before its damage.

        A `kind` is ``log``, ``call`` or one of `opened.READERS`.
        """
        if self._process is None:
            self._start()
        asked = {"kind": kind, "path": str(path), "whole": str(whole), **more}
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        try:
            answer = self._answers.get(timeout=SECONDS)
        except queue.Empty:
            self._end()
            return {"outcome": "hang", "what": f"no end after {SECONDS:g} s"}
        if not answer:
            code = self._process.wait()
            self._end()
            return {"outcome": "crash", "what": f"the process ended with {code}"}
        return json.loads(answer)


def _status(key):
    """Return a number of this process [bytes]; 0 where the system has no /proc."""
    if not _PROC.exists():
        return 0
    lines = (_PROC / "status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(key))


def _reset_peak():
    with contextlib.suppress(OSError):  # only Linux has it
        (_PROC / "clear_refs").write_text("5", encoding="utf-8")


def difference(whole, log, damaged):
    """Return "" where two recordings are alike, ``local``, or what differs first.

    ``rows``: samples are gone, but each that is left is a sample of the whole log, at its time.
    """
    import numpy as np

    if list(whole.channels) != list(log.channels) or whole.kind != log.kind:
        return "channels"
    rows = set()
    for name, channel in whole.channels.items():
        other = log.channels[name]
        if channel.unit != other.unit:
            return "unit"
        if channel.values.shape[1:] != other.values.shape[1:]:
            return "channels"
        if len(channel.time) != len(other.time):
            there = np.abs(other.time[:, None] - channel.time) <= 1e-12
            alike = (other.values[:, None] == channel.values) | np.isnan(other.values[:, None])
            there &= alike if alike.ndim == 2 else alike.all(axis=2)
            return "rows" if (~there.any(axis=1)).sum() <= damaged else "values"
        same = np.isclose(channel.time, other.time, rtol=0, atol=1e-12)
        equal = (channel.values == other.values) | (np.isnan(channel.values) & np.isnan(other.values))
        same &= equal if equal.ndim == 1 else equal.all(axis=1)
        if (~same).sum() > damaged:
            return "clock" if not np.allclose(channel.time, other.time, rtol=0, atol=1e-12) else "values"
        rows |= set(np.flatnonzero(~same).tolist())
    return "local" if rows else ""


def main():
    """Answer requests, one JSON text a line."""
    import warnings
    from unittest.mock import patch

    from fakes.opened import READERS, called, leaves
    from sysid.errors import SysidError, SysidWarning
    from sysid.loaders import formats, isolation, load, registry, table

    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    formats()
    registry.entry_points = lambda group: ()  # other packages' formats take long to look for
    if _PROC.exists():
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_status("VmSize") + 3 * BYTES,) * 2)
    wholes = {}

    def opened(path, asked, whole=False):
        """Return the content of what is opened and the notes on it."""
        if asked["kind"] == "log":
            form, options = asked["form"], asked["options"]
            # Both ways of reading a table take their turn.
            table._SMALL = 0 if path.stat().st_size % 2 else 1 << 17
            log = load(path, format=form if whole or asked["damaged"] % 4 or options else "auto", **options)
            return log, {*log.provenance.notes}
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always", SysidWarning)
            content = dict(leaves(READERS[asked["kind"]](path)))
        return content, {str(warning.message).replace(str(path), "") for warning in heard}

    def judged(asked):
        path = Path(asked["path"])
        try:
            if asked["kind"] == "call":
                called(*asked["call"], path)
                return "equal", ""
            found, notes = opened(path, asked)
        except SysidError as error:
            text, causes = str(error), []
            while error is not None:
                causes.append(error)
                error = error.__cause__
            if any(isinstance(e, MemoryError) or "bad_alloc" in str(e) for e in causes):
                return "memory", text
            # A campaign's log may be what is wrong.
            place = path.parent if asked["kind"] == "campaign" else path
            short = asked["kind"] in ("call", "checkpoint") or text.startswith(str(place))
            short = short and len(text) <= _LONGEST and not _UNSEEN.search(text)
            return "refused" if short else "words", text[:3000]
        place = Path(asked["whole"])
        key = place.read_bytes() if place.is_file() else place
        if key not in wholes:
            wholes.clear()
            with patch.object(registry, "isolated", isolation.read_here):
                wholes[key] = opened(place, asked, whole=True)
        whole, known = wholes[key]
        if asked["kind"] == "log":
            what = difference(whole, found, asked["damaged"])
        else:
            what = "" if found == whole else "values" if found.keys() == whole.keys() else "keys"
        new = notes - known
        if what in ("", "local"):
            return what or "equal", ""
        return ("noted", str(sorted(new, key=str)[0])) if new else ("silent", what)

    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        asked = json.loads(line)
        _reset_peak()
        before = _status("VmRSS")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                outcome, what = judged(asked)
        except BaseException as error:
            import traceback

            outcome, what = "traceback", "".join(traceback.format_exception(error))[-1500:]
        most = max(BYTES, TIMES * Path(asked["path"]).lstat().st_size)
        if _status("VmHWM") - before > most:
            outcome, what = "memory", f"{(_status('VmHWM') - before) / 1e9:.2f} GB; {outcome}: {what[:500]}"
        answers.write(json.dumps({"outcome": outcome, "what": what}) + "\n")
        answers.flush()


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])
    main()
