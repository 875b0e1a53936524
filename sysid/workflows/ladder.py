"""`sysid ladder`: what physics is missing in a fit's model, judged on trials left out."""

from __future__ import annotations

import re
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import FitError
from sysid.journal import Journal, Say
from sysid.storage import check_file, write_file
from sysid.trust.documents import LADDER, write_part
from sysid.trust.ladder import Climber, TermFit
from sysid.workflows.reopen import open_fit


def climb_ladder(
    folder: Path,
    campaign: Path | None = None,
    *,
    adopt: Path | None = None,
    force: bool = False,
    threads: int | None = None,
    say: Say = None,
) -> dict[str, Any]:
    """Add each declared term to a fit, then the best ones together; store and return the document.

    `adopt` is a campaign file to write, with the terms that are worth their place among the free parameters.

    Raises `FitError` for a kind without terms, too few fitted trials, nothing to adopt, or a file to
    adopt them in that is not in the folder of the campaign.
    """
    began = time.perf_counter()
    with Journal(say) as journal:
        opened = open_fit(folder, campaign, threads)
        if adopt is not None:
            check_file(adopt, force=force, error_type=FitError)
            if adopt.resolve().parent != opened.path.resolve().parent:
                raise FitError(
                    f"{adopt}: logs are named from the campaign's folder; write it to {opened.path.parent}"
                )
        terms = [t for t in opened.kind.terms if not set(t.parameters) <= set(opened.space.names)]
        if not terms:
            raise FitError(
                f"{folder}: no further term is declared for a {opened.kind.name} fit of these free "
                "parameters; there is nothing to add"
            )
        problem = opened.whole.fitted
        journal.noun = opened.kind.words.trials
        climber = Climber(problem, np.clip(opened.result.cube[0], 0.0, 1.0), journal.tell)
        ladder = climber.climb(terms, opened.kind.simpler(problem))
        best = ladder.best
        added = [name for term in best.terms for name in term.parameters]
        document = {
            "campaign": opened.stated,
            "trials": list(problem.pieces[0]),
            "symbols": {
                name: row.symbol
                for of in (problem, *(rung.problem for rung in ladder.simpler))
                for name, row in of.space.table.items()
            },
            "base": _rung(ladder.base),
            "alone": [_rung(rung) for rung in ladder.alone],
            "together": [_rung(rung) for rung in ladder.together],
            "simpler": [_rung(rung) for rung in ladder.simpler],
            "keep": [term.title for term in best.terms],
            "parameters": added,
            "evaluations": ladder.evaluations,
            "warnings": journal.sentences(),
            "seconds": time.perf_counter() - began,
        }
    write_part(opened.folder, LADDER, document, {}, fit=opened.result.name, kind=opened.result.kind)
    if adopt is not None:
        if not added:
            raise FitError(f"{folder}: no term is worth its place, so there is nothing to adopt in {adopt}")
        # Numbers of single trials are not named in a campaign.
        names = [row.name for row in opened.space.free if not row.trial] + added
        write_file(adopt, with_free(opened.whole.campaign.source.text, names).encode(), FitError)
    return document


def _rung(rung: TermFit) -> dict[str, Any]:
    return {
        "terms": [term.title for term in rung.terms],
        "values": rung.values,
        "nrmse": rung.nrmse,
        "over_noise": rung.ratio,
        "left_out": rung.left_out.tolist(),
        "gain": rung.gain,
        "chance": rung.chance,
        "kept": rung.kept,
    }


def with_free(text: str, names: list[str]) -> str:
    """Return the text of a campaign with other free parameters; everything else stays as it is written."""
    line = "free = [" + ", ".join(f'"{name}"' for name in names) + "]\n"
    given = tomllib.loads(text).get("parameters", {})
    if "free" in given:
        return re.sub(r"(?m)^[ \t]*free[ \t]*=[ \t]*\[[^\]]*\][^\n]*\n?", line, text, count=1)
    if re.search(r"(?m)^[ \t]*\[parameters\][^\n]*$", text):
        return re.sub(
            r"(?m)^([ \t]*\[parameters\][^\n]*\n?)", lambda m: m[1].rstrip("\n") + "\n" + line, text, count=1
        )
    return f"{text.rstrip()}\n\n[parameters]\n{line}"
