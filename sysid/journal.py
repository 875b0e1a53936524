"""What sysid notices while it works: findings with a code and a sentence, carried by one journal.

Code that notices something calls `notice`. A workflow opens a `Journal`, which passes every finding to the
terminal as it comes and keeps it for the record and the report. Findings about single trials are collected
until `Journal.fold`, so that one finding on many trials is one line.

A decision is taken on `Finding.code`; the sentence is for people.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from contextvars import ContextVar
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self

from sysid.errors import SysidWarning

Severity = Literal["note", "warning"]
# Called with one sentence at a time.
Say = Callable[[str], None] | None


@dataclass(frozen=True)
class Finding:
    """Something noticed about an input or a result.

    Parameters
    ----------
    code : str
        What kind of thing it is, in words joined by hyphens (``log-ends-early``); stable between versions.
    sentence : str
        For people; it does not name the trials.
    severity : {"warning", "note"}
        A note says what was done; a warning says what may be wrong.
    trials : tuple of str
        The trials or logs concerned; empty for the whole campaign.
    size : float
        How bad it is, to choose the worst among repeats; any scale of its own code.
    """

    code: str
    sentence: str
    severity: Severity = "warning"
    trials: tuple[str, ...] = ()
    size: float = 0.0

    def __str__(self) -> str:
        return f"{', '.join(self.trials)}: {self.sentence}" if self.trials else self.sentence

    def document(self) -> dict[str, Any]:
        """Return the finding as it is stored."""
        return {
            "code": self.code,
            "severity": self.severity,
            "sentence": self.sentence,
            "trials": list(self.trials),
        }

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Finding:
        """Return a stored finding."""
        trials = tuple(str(name) for name in document["trials"])
        return cls(document["code"], document["sentence"], document["severity"], trials)


def note(code: str, sentence: str) -> Finding:
    """Return a finding that says what was done."""
    return Finding(code, sentence, "note")


def folded(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Join findings of one code and severity on several trials, in the order of their first mention."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        # Findings about no trial stay apart: their sentences say what distinguishes them.
        key = (finding.code, finding.severity, "" if finding.trials else finding.sentence)
        groups.setdefault(key, []).append(finding)
    out = []
    for group in groups.values():
        names = tuple(dict.fromkeys(name for finding in group for name in finding.trials))
        worst = max(group, key=lambda finding: finding.size)
        if len(names) < 2:
            out += group
            continue
        sentence = worst.sentence
        if len({finding.sentence for finding in group}) > 1:
            sentence += f" (worst: {worst.trials[0]})"
        out.append(Finding(worst.code, sentence, worst.severity, names, worst.size))
    return tuple(out)


def spoken(finding: Finding, trials: int = 0, noun: str = "trials") -> str:
    """Return the line that a terminal and a report print for a finding."""
    if len(finding.trials) > 2 and trials:
        return f"{len(finding.trials)} of {trials} {noun}: {finding.sentence}"
    return str(finding)


class Journal:
    """Carries findings and progress of one command to the terminal, the record and the report.

    Enter it, and `notice` anywhere below adds to it. Journals nest; the innermost one hears.

    Parameters
    ----------
    say : callable, optional
        Called with one line of text at a time.
    noun : str
        What the trials are called: ``drops``, ``trials``.
    """

    def __init__(self, say: Say = None, noun: str = "trials") -> None:
        self._say = say or (lambda line: None)
        self.noun = noun
        self.trials = 0
        self._findings: list[Finding] = []
        self._waiting: list[Finding] = []
        self._open = ExitStack()

    def __enter__(self) -> Self:
        self._open.enter_context(warnings.catch_warnings())
        warnings.simplefilter("always", SysidWarning)
        show = warnings.showwarning

        def hear(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
            # From a thread that knows no journal, or from a loader of someone else.
            if issubclass(category, SysidWarning):
                self.add(Finding("warning", str(message)))
            else:
                show(message, category, *rest, **more)

        warnings.showwarning = hear
        self._open.callback(_OPEN.reset, _OPEN.set(self))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.fold()
        self._open.close()

    def tell(self, line: str) -> None:
        """Print progress; it is not recorded."""
        self._say(line)

    def add(self, finding: Finding) -> None:
        """Keep a finding, once; print it now unless it is about a trial, see `fold`."""
        if finding in self._findings or finding in self._waiting:
            return
        if finding.trials:
            self._waiting.append(finding)
        else:
            self._findings.append(finding)
            self._print(finding)

    def fold(self, trials: int | None = None) -> None:
        """Join what was noticed about single trials and print it; `trials` says how many there are."""
        if trials is not None:
            self.trials = trials
        waiting, self._waiting = self._waiting, []
        for finding in folded(waiting):
            self._findings.append(finding)
            self._print(finding)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings until now, repeats joined."""
        return (*self._findings, *folded(self._waiting))

    def sentences(self, severity: Severity = "warning") -> list[str]:
        """Return the lines of the findings of one severity."""
        return [
            spoken(finding, self.trials, self.noun)
            for finding in self.findings
            if finding.severity == severity
        ]

    def _print(self, finding: Finding) -> None:
        self._say(f"{finding.severity}: {spoken(finding, self.trials, self.noun)}")


_OPEN: ContextVar[Journal | None] = ContextVar("journal", default=None)


def notice(
    code: str, sentence: str, *, trial: str = "", severity: Severity = "warning", size: float = 0.0
) -> None:
    """Add a finding to the open journal; without one, issue a `SysidWarning`, which Python prints.

    Parameters
    ----------
    code, sentence, severity, size
        See `Finding`.
    trial : str
        The trial or log concerned; empty for the whole campaign.
    """
    finding = Finding(code, sentence, severity, (trial,) if trial else (), size)
    journal = _OPEN.get()
    if journal is not None:
        journal.add(finding)
    elif severity == "warning":
        warnings.warn(str(finding), SysidWarning, stacklevel=2)


def tell(line: str) -> None:
    """Print progress by the open journal; without one it is lost."""
    journal = _OPEN.get()
    if journal is not None:
        journal.tell(line)
