"""Opens and prints ranked sets."""

import os
from contextlib import suppress
from pathlib import Path

from sysid import exact_json
from sysid.errors import SysidError, shell
from sysid.export import load_parameter_sets
from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY, WORDS, scores_in_words
from sysid.fit.result import FitResult
from sysid.fit.store import fit_folder
from sysid.parameter_sets import ACCUSED, ADEQUACY, DRAWS, KNOWN_ANYHOW, NOT_ASSESSED, PREDICTS, ParameterSets
from sysid.plugin import NAMED
from sysid.report.fold import print_lines, print_table
from sysid.report.set_tables import adequacy_table, mean_sigma_table, ranked_table, trial_table
from sysid.trust.documents import ExplainDocument
from sysid.trust.use import NOT


def print_sets(source: str | Path, json: bool) -> None:
    """Print the ranked sets of a fit folder or file."""
    sets = load_parameter_sets(source)
    if json:
        print(sets.document().text(), end="")
        return
    # The fitting command ends with the verdict; a reader of the folder or file meets it first.
    if judged := sets.provenance.get(ADEQUACY):
        print_lines([judged["sentence"]], "" if judged["verdict"] == EXPLAINED_BY else "bold yellow")
    print_lines(sets.settings.get(ACCUSED, ()), "bold yellow")
    if says := sets.settings.get(PREDICTS):
        print_lines([says["sentence"]], "bold yellow" if says["word"] == NOT else "")
    _print_tables(sets)
    path = Path(source)
    folder = fit_folder(path) if path.is_dir() or path.name == "fit.h5" else None
    if folder is not None and (climbed := ExplainDocument.read(folder)):
        from sysid.report.explain import conclusion

        print_lines([f"explain: {conclusion(climbed)[0]}; all of it: sysid report {shell(folder)}"])


def is_unfinished(result: FitResult) -> bool:
    """Return whether a limit or the user cut a fit short, or a run of it ended by its budget."""
    budgets = {"evaluations", "generations"}
    return result.state != "done" or any(run.stop_reason in budgets for run in result.runs)


def print_fit(result: FitResult, folder: Path, json: bool, details: bool = False) -> None:
    """Print the verdict on a fit, one table of what it found, and what to do next; or all tables."""
    sets = result.parameter_sets()
    if json:
        head = {"folder": str(folder), "state": result.state}
        print(exact_json.dumps(head | sets.document().model_dump()))
        return
    state = "" if result.state == "done" else " (stopped early: the sets are the best until then)"
    agreed = result.agreement
    so_far = f" (with {agreed.finished} of {agreed.asked} runs finished)" if agreed.unfinished else ""
    print_lines([f"verdict{so_far}: {verdict_on(result)}"])
    if details:
        _print_tables(sets)
    else:
        from sysid.report.trust_tables import answer_table

        print_table(answer_table(sets))
    print_lines([f"fit written to {folder}{state}; next:"])
    place = result.provenance.get("campaign", {}).get("from_fit_folder")
    campaign = os.path.normpath(folder / place) if place else "CAMPAIGN"
    command = f"fit-{result.kind}" if result.kind in ("gear", "motor") else "fit"
    again = [command, campaign, "--out", folder, "--resume", *_given(result, campaign)]
    cut = (again, "first: finish what was cut short")
    use = (
        (["validate", folder, "CAMPAIGN"], "does it predict trials that it has not seen?"),
        (["export", folder, "--out", "sets.json"], "the sets for a simulator"),
    )
    anyhow = (["export", folder, "--for", "gazebo"], "thrust, torque and time constants, which need no model")
    mend = (
        *([anyhow] if result.settings.get(KNOWN_ANYHOW) else []),
        (["check", campaign], "do the logs contradict the campaign?"),
        (["explain", folder], "which stated value, log or physics is wrong?"),
    )
    plugins = [word for file in NAMED for word in ("--plugin", file)]
    for words, what in (
        *([] if result.state == "done" else [cut]),
        (["report", folder], "one page with every trial, to open in a browser"),
        *(mend if result.provenance.get(ADEQUACY, {}).get("verdict") == NOT_BY else use),
    ):
        print_lines([f"  sysid {shell(*words, *plugins):<40}  {what}"])


def _given(result: FitResult, campaign: str) -> list[str]:
    """Return the options that neither a checkpoint nor the campaign has, as they were given."""
    from sysid.campaign import read_campaign

    search = result.provenance.get("search", {})
    same = {"runs": search.get("runs"), "max-evaluations": search.get("max_evaluations")}
    same |= {"surface": result.settings.get("surface")}
    stated: dict[str, object] = {}
    with suppress(SysidError):
        read = read_campaign(campaign)
        law = getattr(getattr(read, "surface", None), "law", None)
        stated = {"runs": read.fit.runs, "surface": law}
    given = {name: value for name, value in same.items() if value and value != stated.get(name)}
    return [word for name, value in given.items() for word in (f"--{name}", str(value))]


def verdict_on(result: FitResult) -> str:
    """Return whether noise explains the fit, and what the data leave open, in one sentence."""
    found, judged = result.provenance.get("findings", ()), result.provenance.get(ADEQUACY)
    words = dict.fromkeys(result.settings.get(NOT_ASSESSED, ()), NOT_ASSESSED)
    words |= {name: row.verdict for name, row in result.judged.items()}
    unfixed = {name for one in found if one["code"] == "not-identifiable" for name in one["parameters"]}
    words |= {name: "not_identifiable" for name in unfixed if words.get(name) != "not_interpretable"}
    lost = [
        f"{word}: {', '.join(sorted(name for name in words if words[name] == word))}"
        for word in ("not_interpretable", "not_identifiable", NOT_ASSESSED)
        if word in words.values()
    ]
    if judged is None:
        fits = f"not compared with the noise, NRMSE {100 * result.nrmse[0]:.2f} %"
    else:
        scores = scores_in_words(*(judged[key] for key in ("nrmse", "floor", "ratio")))
        but_for = judged.get("but_for")
        fits = f"{f'explained but for {but_for}' if but_for else WORDS[judged['verdict']]}, {scores}"
        if judged["verdict"] == NOT_BY:
            lost.insert(0, "no parameter is well known")
    sides = zip(result.parameters, result.at_bound[0].tolist(), strict=True)
    if bounds := sorted(record.name for record, side in sides if side and record.name not in words):
        lost.append(f"at a bound: {', '.join(bounds)}")
    if not all(row.name in result.judged for row in result.searched if row.status == "free"):
        lost.append("no intervals were computed, so it is unknown which parameters are identifiable")
    known = "; ".join(lost) or "every free parameter is identifiable"
    decided = {row.decided_by for row in result.judged.values()} - {None}
    for key in sorted(map(str, decided)):
        names = [name for name, row in result.judged.items() if row.decided_by == key]
        known += f"; the error of {key} as stated decides {', '.join(names)}"
    if judged is not None and judged["verdict"] == NOT_BY and (anyhow := result.settings.get(KNOWN_ANYHOW)):
        fits = f"use {anyhow}, which need no model; of the model: {fits}"
    # A wrong campaign says nothing of a model.
    fits = "; ".join([*result.settings.get(ACCUSED, ()), fits])
    warned = len(result.warnings)
    count = f"{warned or 'no'} warning{'' if warned == 1 else 's'}"
    return f"{fits}; {known.replace('_', ' ')}; {count}"


def _print_tables(sets: ParameterSets) -> None:
    if DRAWS not in sets.provenance:
        print_table(ranked_table(sets))
    print_table(mean_sigma_table(sets))
    if sets.trials and DRAWS not in sets.provenance:
        print_table(trial_table(sets))
    if "adequacy" in sets.provenance:
        print_table(adequacy_table(sets))
