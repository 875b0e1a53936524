"""`sysid compare FIT FIT...`: do two fits differ by more than they may, and which predicts what best?"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.errors import ExportError, FitError
from sysid.journal import Journal, Say
from sysid.report.comparison_page import ComparedFit, OverlaidTrial, comparison_page
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.set_tables import mean_sigma_table
from sysid.report.trust_tables import comparison_table, cross_table, known_table
from sysid.storage import check_file, write_file
from sysid.trust.comparison import Comparison, compare_values, known_values, unjudged
from sysid.trust.documents import TRUST, TrustDocument, read_arrays, with_intervals
from sysid.types import FloatArray
from sysid.workflows.predict import open_under, predict
from sysid.workflows.reopen import OpenedFit, open_fit


def compare_and_print(
    folders: Sequence[Path], *, cross: bool, page: Path | None, threads: int | None, force: bool, say: Say,
    json: bool,
) -> None:  # fmt: skip
    """Compare fits and print the comparison; write its page to a file where one is named."""
    if page is not None:
        check_file(page, force=force, error_type=ExportError)
        if not cross:
            raise ExportError(f"{page}: the page shows how the fits predict each other; leave --no-cross out")
    document, compared = compare_fits(folders, cross=cross, threads=threads, say=say)
    if page is not None:
        write_file(page, comparison_page(document, compared).encode("utf-8"), ExportError)
    if print_result(document.model_dump() | ({"page": str(page)} if page else {}), json):
        return
    if (known := known_table(document)) is not None:
        print_table(known)
    else:
        print_lines(["the fits take the same values as known"])
    print_table(mean_sigma_table(*(fit.sets for fit in compared)))
    print_table(comparison_table(document))
    if document.cross is not None:
        print_table(cross_table(document))
    print_lines([*document.sentences, *([f"wrote {page}"] if page else [])])


def compare_fits(
    folders: Sequence[Path], *, cross: bool = True, threads: int | None = None, say: Say = None
) -> tuple[Comparison, list[ComparedFit]]:
    """Compare fits of one kind; return the comparison and what is drawn of each fit.

    The campaigns of the fits must lie where they lay. With `cross`, every fit's best set predicts every other
    fit's trials. Raises `FitError` for fewer than two fits, or fits of several kinds.
    """
    if len(folders) < 2:
        raise FitError("one fit compares with nothing; name two or more")
    with Journal(say) as journal:
        opened = [open_fit(folder, None, threads) for folder in folders]
        kinds = sorted({fit.result.kind for fit in opened})
        if len(kinds) > 1:
            raise FitError(f"a {kinds[0]} and a {kinds[1]} fit share no parameters; compare fits of one kind")
        short = [folder.name for folder in folders]
        names = short if len(set(short)) == len(short) else [folder.as_posix() for folder in folders]
        documents = [TrustDocument.read(fit.folder) for fit in opened]
        # Two fits of one campaign share its name; a table's columns must not.
        sets = tuple(
            replace(with_intervals(fit.result.parameter_sets(), fit.folder), name=label)
            for fit, label in zip(opened, names, strict=True)
        )
        missing = [label for label, document in zip(names, documents, strict=True) if document is None]
        if missing:
            journal.tell(
                f"{', '.join(missing)}: no profile intervals, so no difference is judged (runs that reach "
                "one optimum agree whatever the data leave open); run sysid trust on each"
            )
        correlations = [
            None if document is None else read_arrays(fit.folder, TRUST).get("correlation")
            for fit, document in zip(opened, documents, strict=True)
        ]
        shifts = [fit.problem.shifts(opened[0].result) for fit in opened]
        differences = compare_values(names, sets, documents, correlations, shifts)
        table, overlaid = _cross(opened, names, threads) if cross else (None, [[] for _ in opened])
    lines = [row.sentence for row in differences if row.differs]
    lines += unjudged(differences)
    if table is not None:
        for j, label in enumerate(names):
            best = int(np.argmin(table[:, j]))
            lines.append(
                f"the trials of {label} are predicted best by {names[best]} ({100 * table[best, j]:.2f} %)"
            )
    laws = [", ".join(str(fit.result.settings.get(law, "")) for law in fit.kind.laws) for fit in opened]
    document = Comparison(
        fits=names,
        kind=kinds[0],
        laws=laws if len(set(laws)) > 1 else [],
        known=known_values([fit.space for fit in opened], shifts),
        differences=differences,
        cross=None if table is None else table.tolist(),
        sentences=lines,
        warnings=journal.sentences(),
    )
    compared = [
        ComparedFit(each, trust, fit.result, trials)
        for each, trust, fit, trials in zip(sets, documents, opened, overlaid, strict=True)
    ]
    return document, compared


def _cross(
    opened: Sequence[OpenedFit], names: Sequence[str], threads: int | None
) -> tuple[FloatArray, list[list[OverlaidTrial]]]:
    """Let the best set of every fit predict the fitted trials of every fit.

    Returns the NRMSE (F, F) of each fit (row) on each fit's trials (column), and those trials by fit.
    """
    out = np.full((len(opened), len(opened)), np.nan)
    overlaid = []
    for j, home in enumerate(opened):
        fitted = home.whole.fitted.trials
        trials = [OverlaidTrial(t.name, t.time, t.measured, t.valid, {}) for t in fitted]
        for i, guest in enumerate(opened):
            fit, whole = guest.result, home.whole
            # The trials are taken under the law of the fit that predicts them.
            if home.kind.under(whole.campaign, fit.settings)[0] != whole.campaign:
                whole = open_under(fit, home.path, threads)[1]
            predicted = predict(fit, home.kind, whole.only(whole.fitted.names))
            out[i, j] = float(predicted.problem.cost.mean(predicted.scored.by_channel)[0])
            signals = zip(predicted.problem.trials, predicted.scored.signals, strict=True)
            for shown, (trial, each) in zip(trials, signals, strict=True):
                shown.predicted[names[i]] = (trial.time, each[0])
        overlaid.append(trials)
    return out, overlaid
