"""What sysid notices while it works: findings with a code and a sentence, carried by one journal.

Code that notices something calls `notice`. A workflow opens a `Journal`, which prints every finding as it
comes and keeps it for the record and the report. Findings about single trials wait for `Journal.fold`, so
that one finding on many trials is one line.

A decision is taken on `Finding.code`; the sentence is for people.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Literal, Self

from sysid.errors import FitError, LogError, SysidWarning, printable

Severity = Literal["note", "warning"]
# First words of the codes of findings about a campaign that contradicts its logs, or an impossible vehicle.
MISSTATED = ("contradicts-", "odd-")
# Called with one sentence at a time.
Say = Callable[[str], None] | None


@dataclass(frozen=True)
class Finding:
    """Something noticed about an input or a result."""

    # Kind of the finding in words joined by hyphens (``log-ends-early``); stable between versions. Codes of
    # warnings are explained in templates/codes.toml.
    code: str
    # For people; it does not name the trials.
    sentence: str
    # A note says what was done; a warning says what may be wrong.
    severity: Severity = "warning"
    # Trials or logs concerned; empty for the whole campaign.
    trials: tuple[str, ...] = ()
    # Badness on any scale, to choose the worst among findings of one code.
    size: float = 0.0
    # Parameters concerned; a parameter of one trial is named without the trial.
    parameters: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{', '.join(self.trials)}: {self.sentence}" if self.trials else self.sentence

    def document(self) -> dict[str, str | list[str]]:
        """Return the finding as it is stored."""
        return {
            "code": self.code,
            "severity": self.severity,
            "sentence": self.sentence,
            "trials": list(self.trials),
            "parameters": list(self.parameters),
        }


def note(code: str, sentence: str) -> Finding:
    """Return a finding that says what was done."""
    return Finding(code, sentence, "note")


def folded(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Join findings of one code on several trials, in the order of their first mention."""
    groups: dict[tuple[object, ...], list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        # Findings about no trial stay apart: their sentences say what distinguishes them.
        key = (finding.code, finding.severity, finding.parameters, not finding.trials and finding.sentence)
        groups.setdefault(key, []).append(finding)
    out = []
    for group in groups.values():
        names = tuple(dict.fromkeys(name for finding in group for name in finding.trials))
        if len(names) < 2:
            out += group
            continue
        worst = max(group, key=lambda finding: finding.size)
        differ = len({finding.sentence for finding in group}) > 1
        sentence = worst.sentence + (f" (worst: {worst.trials[0]})" if differ else "")
        out.append(replace(worst, sentence=sentence, trials=names))
    return tuple(out)


def spoken(finding: Finding, trials: int = 0, noun: str = "trials") -> str:
    """Return the line that a terminal and a report print for a finding."""
    if len(finding.trials) > 2 and trials:
        return f"{len(finding.trials)} of {trials} {noun}: {finding.sentence}"
    return str(finding)


@contextmanager
def heard_warnings(hear: Callable[[str], None]) -> Iterator[None]:
    """Give the sentence of every `SysidWarning` in the block to `hear`; Python shows the other warnings."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def hear_or_show(message: Warning | str, category: type[Warning], *more: Any, **named: Any) -> None:
            if issubclass(category, SysidWarning):
                hear(str(message))
            else:
                show(message, category, *more, **named)

        warnings.showwarning = hear_or_show
        yield


class Journal:
    """Carries findings and progress of one command to the terminal, the record and the report.

    While it is entered, `notice` adds to it; of nested journals the innermost one. `say` takes one line of
    text at a time; `noun` is what the trials are called: ``drops``, ``trials``. The `heard` sentences were
    printed before: they are kept, not repeated. Only with `details` are lines printed that a report has.
    """

    def __init__(
        self, say: Say = None, noun: str = "trials", heard: Iterable[str] = (), details: bool = False
    ) -> None:
        self.details = details
        self._say = (lambda line: say(printable(line))) if say else lambda line: None
        self.noun = noun
        self.trials = 0
        self._heard = {*heard}
        self._findings: list[Finding] = []
        self._waiting: list[Finding] = []
        self._open = ExitStack()

    def __enter__(self) -> Self:
        # A thread that knows no journal, or a foreign loader, warns.
        self._open.enter_context(
            heard_warnings(lambda sentence: self.add(Finding("python-warning", sentence)))
        )
        warnings.simplefilter("always", SysidWarning)
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
        """Join the findings about single trials and print them; `trials` is the number of all trials."""
        if trials is not None:
            self.trials = trials
        waiting, self._waiting = self._waiting, []
        # Misstated values of the campaign come before their symptoms.
        for finding in sorted(folded(waiting), key=lambda one: not one.code.startswith(MISSTATED)):
            self._findings.append(finding)
            self._print(finding)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings until now, repeats joined."""
        return (*self._findings, *folded(self._waiting))

    def sentences(self, severity: Severity = "warning") -> list[str]:
        """Return the lines of the findings of one severity."""
        chosen = [finding for finding in self.findings if finding.severity == severity]
        return [spoken(finding, self.trials, self.noun) for finding in chosen]

    @property
    def misstated(self) -> list[str]:
        """What the logs contradict in the campaign, or no vehicle can be, as sentences."""
        return [str(finding) for finding in self.findings if finding.code.startswith(MISSTATED)]

    @contextmanager
    def blaming(self) -> Iterator[None]:
        """Put what the campaign misstates behind a refusal of its logs or values, as the likely cause."""
        try:
            yield
        except (LogError, FitError) as error:
            if not self.misstated:
                raise
            raise type(error)(f"{error}; the likely cause: {'; '.join(self.misstated)}") from error

    def _print(self, finding: Finding) -> None:
        sentence = spoken(finding, self.trials, self.noun)
        if sentence not in self._heard:
            code = f" [{finding.code}]" if finding.severity == "warning" else ""
            self._say(f"{finding.severity}: {sentence}{code}")


_OPEN: ContextVar[Journal | None] = ContextVar("journal", default=None)


def notice(code: str, sentence: str, *, trial: str = "", size: float = 0.0) -> None:
    """Make a `Finding` and `hear` it."""
    hear(Finding(code, sentence, trials=(trial,) if trial else (), size=size))


def hear(finding: Finding) -> None:
    """Add a finding to the open journal; without one, issue a `SysidWarning`, which Python prints."""
    journal = _OPEN.get()
    if journal is not None:
        journal.add(finding)
    else:
        warnings.warn(str(finding), SysidWarning, stacklevel=2)


def tell(line: str, detail: bool = False) -> None:
    """Print progress, or a `detail` where details are wanted, by the open journal; without one it is lost."""
    journal = _OPEN.get()
    if journal is not None and (journal.details or not detail):
        journal.tell(line)
