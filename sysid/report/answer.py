"""What a page says first: one word, three figures, the next step; then one table of what was found."""

import html
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid.documents import rounded
from sysid.errors import shell
from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY, ROUGHLY_BY
from sysid.fit.result import FitResult
from sysid.parameter_sets import ACCUSED, KNOWN_ANYHOW, Judged, Known
from sysid.parameters import common_name, with_unit
from sysid.report.html import NOTHING, Html, bullets, joined, paragraph
from sysid.report.set_tables import INTERVAL
from sysid.report.table import NONE, Cell, Table, numbers, table, words
from sysid.report.trust_tables import AT_BOUND, ends_of, judged_cell, partners_of
from sysid.trust.documents import Judgement, TrustDocument
from sysid.trust.use import NOT, PREDICTS, ROUGHLY, Use
from sysid.types import FloatArray

# The verdict on a fit in one word.
IN_A_WORD = {
    EXPLAINED_BY: Cell("explained", "good"),
    ROUGHLY_BY: Cell("roughly", "doubtful"),
    NOT_BY: Cell("not explained", "bad"),
}
# What a fit is good for, in a word.
OF_USE = {PREDICTS: Cell(PREDICTS, "good"), ROUGHLY: Cell(ROUGHLY, "doubtful"), NOT: Cell(NOT, "bad")}
NOT_JUDGED = Cell("not judged", "doubtful")


@dataclass(frozen=True, eq=False)
class Reopened:
    """What a report learns from the campaign of its fit and from its logs, where these can be read."""

    # Lower and upper end (n, C) [channel units] of 95 % of the predictions by draws, by trial.
    band: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    # Noise (C,) of the measurement as compared [channel units], by trial.
    noise: Mapping[str, FloatArray] = field(default_factory=dict)
    # Residual over noise [1] of the trials that the fit held back, as `sysid validate` judges them.
    held_out: Mapping[str, float] = field(default_factory=dict)
    # What of use is predicted of these trials; None without any.
    use: Use | None = None
    # True values by parameter [SI], of a synthesized campaign.
    truth: Mapping[str, float] = field(default_factory=dict)
    # Points behind what the fit takes as known, see `sysid.fit.story.Story.evidence`.
    evidence: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    # Why nothing is known: the sentence of the refusal.
    why_not: str = "the campaign was not read"


def answer_box(
    title: str,
    word: Cell | Sequence[Cell],
    name: str,
    tiles: Sequence[tuple[str, str]],
    following: str,
    sketch: Html,
) -> Html:
    """Return the box above all: verdict in a word or more, `tiles` (figure, words), next step, sketch."""
    verdict = "".join(
        f'<span class="word {each.tone}">{html.escape(each.text)}</span>'
        for each in ([word] if isinstance(word, Cell) else word)
    )
    items = "".join(
        f"<li><b{'' if figure[:1].isdigit() else ' class=words'}>{html.escape(figure)}</b>"
        f"<span>{html.escape(what)}</span></li>"
        for figure, what in tiles
    )
    picture = f'<div class="sketch">{sketch.text}</div>' if sketch.text else ""
    # Text between backticks is code.
    parts = html.escape(following).split("`")
    marked = "".join(f"<code>{part}</code>" if k % 2 else part for k, part in enumerate(parts))
    return Html(
        f'<header class="answer"><h1>{html.escape(title)}</h1>{picture}'
        f"<p>{verdict}{html.escape(name)}</p>"
        f'<ul class="tiles">{items}</ul>'
        f'<p class="next"><b>Next:</b> {marked}</p></header>'
    )


def over_noise(fit: FitResult) -> tuple[str, str]:
    """Return how many times the noise the fitted trials leave, and what that is."""
    judged = fit.provenance.get("adequacy")
    if not judged:
        return "not known", "fit over noise: this fit was not judged; fit again"
    worst = judged["misfit"]
    return (
        f"{judged['ratio']:.2f} ×",
        f"fit over noise; worst channel {worst['channel']} {worst['channel_ratio']:.2f} ×",
    )


def predicted_over_noise(
    validations: Mapping[str, Judgement], held_out: Mapping[str, float], command: str
) -> tuple[str, str]:
    """Return how many times the noise the trials that were not fitted leave; else what to run."""
    if held_out:
        values = list(held_out.values())
        worst = max(held_out, key=lambda name: held_out[name])
        what = f"prediction over noise, {len(values)} not fitted; worst {worst} {held_out[worst]:.2f} ×"
        return f"{np.mean(values):.2f} ×", what
    for name, document in validations.items():
        if np.isfinite(document.ratio):
            return f"{document.ratio:.2f} ×", f"prediction over noise, {name}"
    return "not known", f"prediction over noise: run {command}"


def use_tile(use: Use | None) -> list[tuple[str, str]]:
    """Return how many numbers of use the bands hold, and how wide these are; nothing where none is known."""
    if use is None or not use.word:
        return []
    ends = f"; end right in {use.classes_right} of {use.classes}" if use.classes else ""
    said = f"numbers of use predicted within 95 % of draws: {use.in_widths}{ends}"
    return [(f"{use.held} of {use.count}", said)]


def counts(rows: Collection[Judged] | None, command: str) -> tuple[str, str]:
    """Return how many parameters are well, weakly and not identifiable."""
    if rows is None:
        return "not known", f"parameters identifiable: run {command}"
    kinds = ["not" if row.lost else row.verdict for row in rows]
    parts = [f"{kinds.count(kind)} {kind}" for kind in ("well", "weakly", "not")]
    return " · ".join(parts), f"identifiable, of {len(rows)} parameters judged"


def next_step(
    fit: FitResult,
    trust: TrustDocument | None,
    predicted: bool,
    folder: str,
    noun: str = "trial",
    use: Use | None = None,
) -> str:
    """Return the one sentence of what to do next: what stands in the way first."""
    judged = fit.provenance.get("adequacy", {})
    if fit.agreement.unfinished or fit.state != "done":
        return "the search was not finished; fit again with more generations before you read a number."
    if accused := fit.settings.get(ACCUSED):
        return f"{'; '.join(accused)}."
    good_for = ""
    if use is not None and use.word in (PREDICTS, ROUGHLY):
        good_for = f"maps may use the sets, because it {use.sentence}. "
    if judged.get("verdict") == NOT_BY:
        at = judged["misfit"]
        look = (
            f"look at {at['channel']} {at['phase']} on {at['trial']}, where the misfit sits, and change the "
            f"campaign or the model: `sysid explain {shell(folder)}` tries what it may lack."
        )
        if anyhow := fit.settings.get(KNOWN_ANYHOW):
            return (
                f"use {anyhow}: they need no model, and `sysid export {shell(folder)} --for gazebo` (or px4, "
                f"ardupilot, rotorpy, crazyflow) writes them. Values of the model do not count yet: {look}"
            )
        return f"{good_for}No value counts by itself: {look}" if good_for else f"no value counts yet: {look}"
    if trust is None:
        return f"run `sysid trust {shell(folder)}` for intervals: what the data identify is not known yet."
    lost = [
        f"{row.symbol} does not matter for these {noun}s: any value "
        f"{'in its bounds' if row.interval == 'open' else with_unit(row.interval, row.unit)} fits alike"
        for row in trust.parameters
        if row.lost
    ]
    if not predicted:
        return f"run `sysid validate {shell(folder)}`: how well it predicts is not known yet."
    if use is not None and use.word == NOT:
        return f"do not land with these sets: it {use.sentence}. Look at the validation, trial by trial."
    if lost:
        return f"use the sets: `sysid export {shell(folder)}` writes them. {'; '.join(lost)}."
    if judged.get("verdict") == ROUGHLY_BY:
        at = judged["misfit"]
        return (
            f"use the sets with care: {at['channel']} {at['phase']} is {at['phase_ratio']:.1f} × its noise."
        )
    return f"use the sets: `sysid export {shell(folder)}` writes them for a simulator."


def parameter_table(fit: FitResult, trust: TrustDocument | None, truth: Mapping[str, float]) -> Table:
    """Return the one table of free parameters: value, 95 % interval, verdict, partners, measured, truth."""
    assessed = trust.by_name if trust else {}
    rows = [row for row in fit.known.values() if row.record.status == "free"]
    symbols = {record.name: record.symbol for record in fit.parameters if record.symbol}

    def partners(row: Known) -> str:
        found = assessed.get(row.record.name)
        return partners_of(found.partners, symbols) if found else NONE

    def true(row: Known) -> str | Cell:
        value = truth.get(row.record.name)
        if value is None:
            return NONE
        inside = row.judged is None or row.judged.contains(value)
        return rounded(value) if inside else Cell(f"{rounded(value)} outside", "doubtful")

    ranges = any(row.record.measured_range for row in rows)
    return table(
        "",
        rows,
        (
            words("symbol", lambda row: row.record.symbol or row.record.name),
            words("name", lambda row: common_name(row.record).replace("_", " ")),
            numbers("value", Known.text),
            INTERVAL,
            words("unit", lambda row: row.record.unit or "1"),
            words("verdict", lambda row: judged_cell(row.judged) if row.judged else NONE),
            words("correlates with", partners),
            numbers("measured", lambda row: ends_of(row.record.measured_range)) if ranges else None,
            numbers("truth", true) if truth else None,
        ),
        AT_BOUND if any("*" in row.text() for row in rows) else "",
    )


def grouped_warnings(warnings: Sequence[str], findings: Sequence[Mapping[str, Any]]) -> Html:
    """Return the warnings, grouped by their code, each group below a heading."""
    groups: dict[str, list[str]] = {}
    for warning in warnings:
        codes = (each["code"] for each in findings if each["sentence"] in warning)
        groups.setdefault(next(codes, "intervals and other trials"), []).append(warning)
    return joined([
        paragraph(f"{code.replace('-', ' ')[:1].upper()}{code.replace('-', ' ')[1:]}", "caption")
        + bullets(group, "warnings")
        for code, group in groups.items()
    ]) if groups else NOTHING  # fmt: skip
