"""`sysid check CAMPAIGN`: are the logs good, do they excite the model, and what will they determine?"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from sysid.fit.kind import Kind
from sysid.fit.problem import Problem
from sysid.fit.provenance import CampaignFile
from sysid.fit.story import Story
from sysid.journal import Journal, Say
from sysid.trust.documents import CandidateRecording, CheckDocument, Expected, ExpectedParameter
from sysid.trust.linearized import Linearized
from sysid.trust.sensitivity import (
    any_noise,
    drawn_outlooks,
    expectations,
    information_by_channel,
    nominal_point,
    rank_candidates,
)
from sysid.trust.stated import better_measured
from sysid.trust.verdicts import WEAKLY, WELL, as_half_width, sentences, verdict
from sysid.workflows.kinds import naming_campaign, open_campaign

# Candidates that are named.
_NAMED = 3
_NO_NOISE = "the noise of the channels is not known, so nothing is expected of the trials; state it"
_WITHHELD = "no verdict: the campaign contradicts its logs, or itself; mend what is named, then check again"


def check_campaign(
    path: Path,
    *,
    surface: str | None = None,
    threads: int | None = None,
    say: Say = None,
    details: bool = False,
) -> CheckDocument:
    """Judge a campaign before it is fitted.

    `surface` overrides a gear campaign's friction law. Raises `SysidError` when an input cannot be used.
    """
    began = time.perf_counter()
    path = Path(path)
    with naming_campaign(path):
        law = {} if surface is None else {"surface": surface}
        kind, campaign, ignored = open_campaign(path, law=law)
        with Journal(say, kind.words.trials, details=details) as journal, journal.blaming():
            for finding in ignored:
                journal.add(finding)
            whole = kind.open(campaign, path, threads)
            # A misstatement of the campaign, told first, is the cause of what may fail below.
            story = kind.story(whole)
            seen: dict[str, object] = {"quality": story.quality()}
            journal.fold(len(whole.trials))
            seen |= story.about()
            story.tell_stated()
            problem = whole.fitted.exact
            unlikely = (finding.code.startswith("unlikely-") for finding in journal.findings)
            withheld = bool(journal.misstated) or any(unlikely)
            if withheld or not any_noise(problem):
                out: dict[str, Any] = {
                    "parameters": [], "limits": {"well": WELL, "weakly": WEAKLY}, "candidates": [],
                    "sentences": [_WITHHELD if withheld else _NO_NOISE],
                }  # fmt: skip
            else:
                out = _expected(problem, kind, story)
            out = {**out, **seen, "excitation": story.excitation(), "withheld": withheld}
            warnings = journal.sentences()
    return CheckDocument(
        campaign=CampaignFile(file=path.name, sha256=campaign.source.sha256, name=campaign.name),
        kind=kind.name,
        warnings=warnings,
        seconds=time.perf_counter() - began,
        **out,
    )


def _expected(problem: Problem, kind: Kind, story: Story[Any]) -> dict[str, Any]:
    """Return what the trials will determine, what to record next, and that in sentences."""
    noise = problem.correlation()
    drawn = drawn_outlooks(problem, noise)
    view, expected = expectations(problem, nominal_point(problem.space), noise, drawn)
    weak = np.array([row.verdict != "well" for row in expected])
    candidates: list[CandidateRecording] = []
    if weak.any():
        made = kind.candidates(problem, problem.space.full(view.point[None])[0])
        if made is not None:
            candidates = rank_candidates(problem, view, made[0], tuple(made[1]), weak, drawn)
    out = _verdicts(problem, view, expected, candidates, kind.words.single)
    out["sentences"] += better_measured(problem.space, view, story.keys)
    out["sentences"] += story.advice([row.name for row in expected if row.verdict != "well"])
    return out


def _verdicts(
    problem: Problem,
    view: Linearized,
    expected: tuple[Expected, ...],
    candidates: list[CandidateRecording],
    single: str,
) -> dict[str, Any]:
    """Return verdicts, the candidates, and what they say in sentences; `single` is what a candidate is."""
    shares = information_by_channel(problem, view)
    lines = list(sentences(expected))
    # Derivatives that depend on the step make a verdict a guess, unless it stays beyond the last limit.
    least = view.half_widths / (1.0 + view.jacobian.doubt)
    rows = zip(expected, view.jacobian.trusted, least, strict=False)
    rough = [row.symbol for row, good, width in rows if not good and width < WEAKLY]
    if rough:
        lines.append(f"rough verdicts, because the derivatives depend on their step: {', '.join(rough)}")
    beyond: list[str] = []
    for row in expected:
        if row.verdict == "well":
            continue
        best = min(candidates, key=lambda c, name=row.name: c.worse(name), default=None)  # type: ignore[misc]
        after = np.inf if best is None else best.worse(row.name)
        lifts = _lifts(row, after)
        if verdict(row.half_width) == "well" and not lifts:
            lines.append(
                f"{row.symbol}: {as_half_width(row.half_width)} at {row.value:.3g} {row.unit}, but "
                f"{as_half_width(row.half_width_over_bounds)} at other values within its bounds: the "
                "trials determine it only if it lies where the defaults do; state narrower bounds if you can"
            )
        elif best is not None and lifts:
            lines.append(
                f"to determine {row.symbol}: {best.title} ({as_half_width(row.worse)} now, "
                f"{as_half_width(after)} with it)"
            )
        elif best is not None:
            beyond.append(row.symbol)
    if beyond:
        lines.append(f"no one more {single} would determine {', '.join(beyond)}")
    # Worth recording is what makes a verdict better.
    lifting = [(c, [e.symbol for e in expected if _lifts(e, c.worse(e.name))]) for c in candidates]
    worth = [f"{c.title} (a better verdict on {', '.join(symbols)})" for c, symbols in lifting if symbols]
    if worth:
        lines.append("record next, best for all weak parameters together: " + ", else ".join(worth[:_NAMED]))
    return {
        "parameters": [
            ExpectedParameter(**vars(row), channels=dict(zip(problem.channels, share.tolist(), strict=True)))
            for row, share in zip(expected, shares, strict=True)
        ],
        "limits": {"well": WELL, "weakly": WEAKLY},
        "candidates": candidates,
        "sentences": lines,
    }


def _lifts(row: Expected, half_width: float) -> bool:
    """Return whether a half-width belongs to a better verdict than what is expected now."""
    return half_width < row.worse and verdict(half_width) != row.verdict
