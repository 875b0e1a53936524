"""The verdict on a fit in a few sentences: how well it fits and predicts, and what the data fix."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sysid.fit.optima import unfixed
from sysid.fit.result import FitResult
from sysid.parameter_sets import in_place_of_digits
from sysid.parameters import in_words
from sysid.report.drawing import percent_text
from sysid.report.trust_tables import verdict_words

_COUNTS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
)  # fmt: skip


def verdict_sentences(
    fit: FitResult,
    against: FitResult | None,
    trust: Mapping[str, Any] | None,
    validated: Mapping[str, Mapping[str, Any]],
    warnings: int,
    *,
    model: str,
    noun: str = "trial",
) -> list[str]:
    """Return the verdict on a fit, a sentence each.

    Parameters
    ----------
    against : FitResult, optional
        The same sets on trials of another campaign.
    trust, validated : mapping
        Documents of intervals and verdicts, and of validations by name.
    warnings : int
        How many stand below the verdict.
    model, noun : str
        What was fitted and what one of its trials is called: ``landing gear``, ``drop``.
    """
    out = [_fitted(fit, model, noun), *_predicted(fit, against, validated), *_fixed(fit, trust), *_runs(fit)]
    if fit.state != "done":
        out.append("It was stopped early: these are the sets that it had until then.")
    if warnings:
        verb = "s stand" if warnings > 1 else " stands"
        out.append(f"{_count(warnings).capitalize()} warning{verb} below.")
    return out


def open_parameters(fit: FitResult) -> tuple[str, ...]:
    """Return the free parameters that the data do not fix: by the candidates, or by a profile of their own.

    See `sysid.fit.optima.unfixed`, a lower bound on what is open.
    """
    free = [record.name for record in fit.parameters if record.status == "free"]
    wide: set[str] = set()
    if fit.runs and fit.searched:
        flags = unfixed(fit.runs, fit.searched)
        wide = {record.name for record, flag in zip(fit.searched, flags, strict=True) if flag}
    return tuple(name for name in free if name in wide or in_place_of_digits(fit.settings, name) is not None)


def _fitted(fit: FitResult, model: str, noun: str) -> str:
    trials = sum(trial.use == "fit" for trial in fit.trials)
    denominator = fit.provenance.get("nrmse_denominator", "std")
    low, high = percent_text(float(fit.nrmse.min())), percent_text(float(fit.nrmse.max()))
    span = low if low == high else f"{low} to {high}"
    sets = f"{_count(len(fit.nrmse))} set{'' if len(fit.nrmse) == 1 else 's'}"
    return (
        f"{fit.name}, {model}: the {sets} fit{'s' if len(fit.nrmse) == 1 else ''} {_count(trials)} "
        f"{noun}{'' if trials == 1 else 's'} with an NRMSE of {span} "
        f"(rms error over {denominator} of the measurement)."
    )


def _predicted(
    fit: FitResult, against: FitResult | None, validated: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    out = []
    for result in (fit, against):
        trials = sum(trial.use == "validate" for trial in result.trials) if result is not None else 0
        if result is not None and trials:
            mean = percent_text(float(result.mean_nrmse("validate")[0]))
            where = "" if result is fit else f" of {result.name}"
            word = "trial" if trials == 1 else "trials"
            out.append(f"It predicts {_count(trials)} {word}{where} that it never saw with {mean}.")
    for name, document in validated.items():
        word = "is doubtful" if document.get("flagged") else "holds"
        mean = percent_text(float(document.get("nrmse", float("nan"))))
        out.append(f"The validation on {name} {word} ({mean}).")
    if not out:
        out.append("Nothing is known about trials that were not fitted: none was held back.")
    return out


def _fixed(fit: FitResult, trust: Mapping[str, Any] | None) -> list[str]:
    out = []
    if fit.runs and fit.agreement.unfinished:
        out.append("The search was not finished: nothing is known about what the data fix.")
        if trust is None:
            return out
    named = {record.name: in_words(record) for record in fit.parameters}
    if trust is not None:
        groups: dict[str, list[str]] = {}
        for row in trust["parameters"]:
            groups.setdefault(row["verdict"], []).append(named[row["name"]])
        parts = [f"{verdict_words(verdict)}: {', '.join(names)}" for verdict, names in groups.items()]
        where = "around the unfinished best set" if out else "by profile"
        return [*out, f"What the data fix, {where}: {'; '.join(parts)}."]
    opened = open_parameters(fit)
    free = [record.name for record in fit.parameters if record.status == "free"]
    closed = [named[name] for name in free if name not in opened]
    if closed:
        out.append(f"The data hold {', '.join(closed)}.")
    if opened:
        names = ", ".join(named[name] for name in opened)
        out.append(f"They do not fix {names}: read no digits into that.")
    flagged = sorted({fit.parameters[i].name for i in np.flatnonzero((fit.at_bound != 0).any(axis=0))})
    if flagged:
        names = ", ".join(named[name] for name in flagged)
        out.append(f"Sets end at a bound in {names}.")
    out.append("Intervals have not been computed: this judges by the spread of the search alone.")
    return out


def _runs(fit: FitResult) -> list[str]:
    if not fit.runs:
        return ["The fit holds no runs."]
    agreement, total = fit.agreement, len(fit.runs)
    # Where a run was cut is no optimum, so none is the best one.
    if agreement.unfinished:
        return [f"{agreement.sentence()}."]
    if total == 1:
        return ["A single run cannot say whether its optimum is the best one."]
    return [f"{agreement.reached} of {total} independent runs ended in the best optimum."]


def _count(number: int) -> str:
    return _COUNTS[number] if number < len(_COUNTS) else str(number)
