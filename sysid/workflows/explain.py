"""`sysid explain`: what a campaign states wrongly, and what physics the model lacks beside that."""

import os
import time
from collections.abc import MutableMapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from sysid.campaign import read_campaign
from sysid.campaign.file import resolve_log
from sysid.campaign.swaps import Swap
from sysid.errors import ExportError, FitError, shell
from sysid.fit.adequacy import EXPLAINED_BY, adequacy
from sysid.journal import Journal, Say
from sysid.report.drawing import check_figure_name, save_figure
from sysid.report.explain import conclusion, figure_rungs, moves_table, rungs_table
from sysid.report.fold import print_lines, print_result, print_table
from sysid.storage import check_file, write_file
from sysid.trust.assessment import judge_fit
from sysid.trust.documents import ExplainDocument, LadderRung, TrustDocument, write_part
from sysid.trust.ladder import Climber, TermFit
from sysid.trust.suspects import put_on_trial, without_accused
from sysid.workflows.reopen import OpenedFit, open_fit, shown_from_here


def explain_and_print(
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
    """Find what a campaign states wrongly, and which terms its model lacks; store, print and draw that.

    `adopt` is a campaign file to write: a mistake is undone, a bad trial not fitted, terms to keep are free.
    Raises `SysidError` for a kind without terms, too few fitted trials and a file that cannot be written.
    """
    if figure is not None:
        check_figure_name(figure)
        check_file(figure, force=force, error_type=ExportError)
    opened = open_fit(folder, campaign, threads)
    if adopt is not None:
        _check_adopting(opened, adopt, force)
    trust = TrustDocument.read(opened.folder)
    document = explain_opened(opened, say)
    if adopt is not None:
        line = [_adopted(opened, document, adopt)]
    else:
        able = document.keep or _swaps(opened, document) or _accused(document, "trial")
        line = ["--adopt FILE writes a campaign with what to change"] if able else []
    if not print_result(document.printed(), json):
        if document.together:
            print_table(moves_table(document, trust))
        print_table(rungs_table(document))
        print_lines([*conclusion(document), *line])
        print_lines([f"{document.evaluations} simulations in {document.seconds:.0f} s"])
    if figure is not None:
        save_figure(figure_rungs(document), figure)


def explain_opened(opened: OpenedFit, say: Say = None) -> ExplainDocument:
    """Try what the campaign may state wrongly, then physics on what that leaves; store and return it.

    FitError where there is neither.
    """
    began = time.perf_counter()
    problem, terms = opened.whole.fitted, opened.terms
    start = np.clip(opened.result.cube[0], 0.0, 1.0)
    with Journal(say) as journal:
        journal.noun = opened.kind.words.trials
        trust, evaluations = TrustDocument.read(opened.folder), 0
        if trust is None or trust.campaign["sha256"] != opened.stated["sha256"]:
            journal.tell("what the campaign states, and single trials")
            judged, noise, _, without = judge_fit(opened.problem, start)
            inquiry = put_on_trial(opened.problem, noise, judged, without)
            suspects, evaluations = inquiry.suspects, inquiry.evaluations
        else:
            suspects = trust.suspects
        accused = [one for one in suspects if one.sentences]
        if not terms and not accused:
            raise FitError(
                f"{opened.folder}: no further term is declared for a {opened.kind.name} fit of these free "
                "parameters, and nothing is wrong with what its campaign states; there is nothing to add"
            )
        problem, start = without_accused(problem, start, suspects)
        climber = Climber(problem, start, journal.tell)
        settled = any(one.verdict == EXPLAINED_BY for one in accused)
        ladder = climber.climb(() if settled else terms, () if settled else opened.kind.simpler(problem))
        warnings = journal.sentences()
    best = ladder.best
    rows = [
        row
        for of in (problem, *(rung.problem for rung in (*ladder.simpler, *ladder.alone)))
        for row in of.space.table.values()
    ]
    document = ExplainDocument(
        fit=opened.result.name,
        kind=opened.result.kind,
        campaign=opened.stated,
        suspects=suspects,
        trials=list(problem.pieces[0]),
        parts=problem.pieces[0] != problem.names,
        symbols={row.name: row.symbol for row in rows},
        units={row.name: row.unit for row in rows},
        meanings={row.name: row.meaning for row in rows},
        adequacy=adequacy(best.problem, best.problem.space.full(best.point[None])[0]),
        base=_rung(ladder.base),
        alone=[_rung(rung) for rung in ladder.alone],
        together=[_rung(rung) for rung in ladder.together],
        simpler=[_rung(rung) for rung in ladder.simpler],
        keep=[term.title for term in best.terms],
        parameters=[name for term in best.terms for name in term.parameters],
        evaluations=ladder.evaluations + evaluations,
        warnings=warnings,
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


def _accused(document: ExplainDocument, what: str) -> list[str]:
    return [name for one in document.suspects if one.sentences and one.what == what for name in one.names]


def _swaps(opened: OpenedFit, document: ExplainDocument) -> list[Swap]:
    """Return the accused mistakes that keys of the campaign contain."""
    accused = _accused(document, "swap")
    return [swap for swap, _ in opened.problem.mistakes if swap.title in accused and swap.keys]


def _check_adopting(opened: OpenedFit, adopt: Path, force: bool) -> None:
    """Refuse before the minute of an explanation what could not be written after it."""
    check_file(adopt, force=force, error_type=FitError)
    if read_campaign(opened.path) != opened.whole.campaign:
        law = ", ".join(f"{name} {opened.result.settings.get(name)}" for name in opened.kind.laws)
        raise FitError(
            f"{opened.path}: states another law than the fit's, {law}, whose terms do not belong there; "
            "write that law into a copy of the file, and name it with --campaign"
        )


def _adopted(opened: OpenedFit, document: ExplainDocument, adopt: Path) -> str:
    """Write the campaign with the terms to keep, without a mistake or a bad trial; return what was done."""
    bad, swaps = _accused(document, "trial"), _swaps(opened, document)
    if not document.parameters and not bad and not swaps:
        measured = [*_accused(document, "value"), *_accused(document, "swap")]
        why = "no term is kept, so there is nothing to adopt"
        if measured:
            why = f"what is measured again belongs there: {', '.join(measured)}"
        return f"{adopt} was not written: {why}"
    names: list[str] = []
    if document.parameters:
        # Numbers of single trials are not named in a campaign, nor is what it states.
        names = [row.name for row in opened.space.found if not row.trial] + document.parameters
    text = edited(opened.whole.campaign.source.text, names, bad, opened.path, adopt, swaps)
    write_file(adopt, text.encode(), FitError)
    # The campaign keeps its name, by which its fit would take the place of this one.
    folder = opened.folder.resolve()
    out = shown_from_here(folder.with_name(f"{folder.name}-{adopt.stem}"))
    return f"wrote {adopt}; fit it next: {shell('sysid', 'fit', adopt, '--out', out)}"


def edited(
    text: str, free: Sequence[str], bad: Sequence[str], before: Path, after: Path, swaps: Sequence[Swap] = ()
) -> str:
    """Return the text of a campaign file `before` as a file `after`, with all comments.

    It has other `free` parameters, if any, does not fit the `bad` trials, and has no `swaps`.
    """
    campaign: MutableMapping[str, Any] = tomlkit.parse(text)
    if free:
        campaign.setdefault("parameters", tomlkit.table())["free"] = [*free]
    for swap in swaps:
        swap.undo_in(campaign)
    for trial in campaign["trials"]:
        if trial["name"] in bad:
            trial["use"] = "validate"
    _move_logs(campaign, before, after)
    return tomlkit.dumps(campaign)


def _move_logs(node: MutableMapping[str, Any], before: Path, after: Path) -> None:
    """Let the logs that a campaign names be found from another folder."""
    if before.resolve().parent == after.resolve().parent:
        return
    for key, value in node.items():
        if isinstance(value, str) and (key == "log" or key.endswith("_log")):
            log = resolve_log(before, value).resolve()
            # Windows has no relative path to another drive.
            same = log.drive == after.resolve().drive
            node[key] = Path(os.path.relpath(log, after.resolve().parent) if same else log).as_posix()
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, MutableMapping):
                _move_logs(child, before, after)
