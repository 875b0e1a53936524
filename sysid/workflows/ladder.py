"""`sysid ladder`: what physics is missing in a fit's model, judged on trials left out."""

from __future__ import annotations

import re
import time
import tomllib
from contextlib import suppress
from pathlib import Path

import numpy as np

from sysid.campaign import read_campaign
from sysid.errors import ExportError, FitError
from sysid.fit.adequacy import adequacy
from sysid.journal import Journal, Say
from sysid.report.drawing import check_figure_name, save_figure
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.ladder import conclusion, figure_rungs, moves_table, rungs_table
from sysid.storage import check_file, write_file
from sysid.trust.documents import LadderDocument, LadderRung, TrustDocument, write_part
from sysid.trust.ladder import Climber, TermFit
from sysid.workflows.reopen import OpenedFit, open_fit, shown_from_here


def climb_and_print(
    folder: Path,
    campaign: Path | None = None,
    *,
    adopt: Path | None = None,
    figure: Path | None = None,
    force: bool = False,
    threads: int | None = None,
    json: bool = False,
    say: Say = None,
) -> None:
    """Add each declared term to a fit, find those to keep; store, print and draw what came of it.

    `adopt` is a campaign file to write where terms are to be kept, which are then free parameters. Raises
    `SysidError` for a kind without terms, too few fitted trials, a file that cannot be written, and, after
    all is printed, for a campaign that cannot be edited.
    """
    if figure is not None:
        check_figure_name(figure)
        check_file(figure, force=force, error_type=ExportError)
    with Journal(say) as journal:
        opened = open_fit(folder, campaign, threads)
        if adopt is not None:
            _check_adopting(opened, adopt, force)
        trust = TrustDocument.read(opened.folder)
        document = climb_ladder(opened, journal)
    lines = []
    try:
        if adopt is not None:
            lines.append(_adopted(opened, document.parameters, adopt))
        elif document.keep:
            lines.append("--adopt FILE writes a campaign with what to keep")
    finally:
        if not print_result(document.printed(), json):
            print_table(moves_table(document, trust))
            print_table(rungs_table(document))
            print_lines([*conclusion(document), *lines])
            print_lines([f"{document.evaluations} simulations in {document.seconds:.0f} s"])
        if figure is not None:
            save_figure(figure_rungs(document), figure)


def climb(
    folder: Path, campaign: Path | None = None, threads: int | None = None, say: Say = None
) -> LadderDocument:
    """Climb the ladder of a fit folder, see `climb_and_print`."""
    with Journal(say) as journal:
        return climb_ladder(open_fit(folder, campaign, threads), journal)


def climb_ladder(opened: OpenedFit, journal: Journal) -> LadderDocument:
    """Climb the ladder of a fit; store and return the document. FitError where there is none to climb."""
    began = time.perf_counter()
    terms = opened.terms
    if not terms:
        raise FitError(
            f"{opened.folder}: no further term is declared for a {opened.kind.name} fit of these free "
            "parameters; there is nothing to add"
        )
    problem = opened.whole.fitted
    journal.noun = opened.kind.words.trials
    climber = Climber(problem, np.clip(opened.result.cube[0], 0.0, 1.0), journal.tell)
    ladder = climber.climb(terms, opened.kind.simpler(problem))
    best = ladder.best
    rows = [
        row
        for of in (problem, *(rung.problem for rung in (*ladder.simpler, *ladder.alone)))
        for row in of.space.table.values()
    ]
    document = LadderDocument(
        fit=opened.result.name,
        kind=opened.result.kind,
        campaign=opened.stated,
        trials=list(problem.pieces[0]),
        parts=problem.pieces[0] != problem.names,
        symbols={row.name: row.symbol for row in rows},
        units={row.name: row.unit for row in rows},
        adequacy=adequacy(best.problem, best.problem.space.full(best.point[None])[0]),
        base=_rung(ladder.base),
        alone=[_rung(rung) for rung in ladder.alone],
        together=[_rung(rung) for rung in ladder.together],
        simpler=[_rung(rung) for rung in ladder.simpler],
        keep=[term.title for term in best.terms],
        parameters=[name for term in best.terms for name in term.parameters],
        evaluations=ladder.evaluations,
        warnings=journal.sentences(),
        seconds=time.perf_counter() - began,
    )
    write_part(opened.folder, document, {})
    return document


def _rung(rung: TermFit) -> LadderRung:
    return LadderRung(
        terms=[term.title for term in rung.terms],
        values=rung.values,
        nrmse=rung.nrmse,
        over_noise=rung.ratio,
        left_out=rung.left_out.tolist(),
        misfit=rung.misfit.tolist(),
        gain=rung.gain,
        chance=rung.chance,
        kept=rung.kept,
    )


def _check_adopting(opened: OpenedFit, adopt: Path, force: bool) -> None:
    """Refuse before the minute of a ladder what could not be written after it."""
    check_file(adopt, force=force, error_type=FitError)
    if adopt.resolve().parent != opened.path.resolve().parent:
        raise FitError(
            f"{adopt}: logs are named from the campaign's folder; write it to {opened.path.parent}"
        )
    if read_campaign(opened.path) != opened.whole.campaign:
        law = ", ".join(f"{name} {opened.result.settings.get(name)}" for name in opened.kind.laws)
        raise FitError(
            f"{opened.path}: states another law than the fit's, {law}, whose terms do not belong there; "
            "write that law into a copy of the file, and name it with --campaign"
        )


def _adopted(opened: OpenedFit, added: list[str], adopt: Path) -> str:
    """Write the campaign with the terms to keep; return what was done."""
    if not added:
        return f"{adopt} was not written: no term is kept, so there is nothing to adopt"
    # Numbers of single trials are not named in a campaign.
    names = [row.name for row in opened.space.free if not row.trial] + added
    write_file(adopt, with_free(opened.whole.campaign.source.text, names).encode(), FitError)
    # The campaign keeps its name, by which its fit would take the place of this one.
    folder = opened.folder.resolve()
    out = shown_from_here(folder.with_name(f"{folder.name}-{adopt.stem}"))
    return f"wrote {adopt}; fit it next: sysid fit {adopt} --out {out}"


def with_free(text: str, names: list[str]) -> str:
    """Return the text of a campaign with other free parameters; everything else stays as it is written.

    FitError, with the line to write, for a text in which another thing would change.
    """
    line = "free = [" + ", ".join(f'"{name}"' for name in names) + "]\n"
    wanted = tomllib.loads(text)
    given = wanted.setdefault("parameters", {})
    head = r"(?m)^([ \t]*\[parameters\][^\n]*\n?)"
    if "free" in given:
        changed = re.sub(r"(?m)^[ \t]*free[ \t]*=[ \t]*\[[^\]]*\][^\n]*\n?", lambda _: line, text, count=1)
    elif re.search(head, text):
        changed = re.sub(head, lambda m: m[1].rstrip("\n") + "\n" + line, text, count=1)
    else:
        changed = f"{text.rstrip()}\n\n[parameters]\n{line}"
    given["free"] = names
    with suppress(tomllib.TOMLDecodeError):
        if tomllib.loads(changed) == wanted:
            return changed
    raise FitError(
        "the campaign states its parameters in a form that is not edited here, so nothing was written; copy "
        f"it and write into the table [parameters] of the copy: {line.strip()}"
    )
