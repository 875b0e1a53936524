"""A newcomer's walk from a raw folder to parameter sets, for a notebook: look, describe, fit."""

from __future__ import annotations

import io
from pathlib import Path

from rich.console import Console

from sysid.campaign import read_campaign
from sysid.campaign.file import resolve_log
from sysid.campaign.read_logs import load_stated
from sysid.report.drawing import WIDTH
from sysid.report.fit_report import FitReport
from sysid.report.html import Html, picture, preformatted
from sysid.report.inspect_figures import figure_logs
from sysid.trials.look import inspect_recording
from sysid.workflows.fit import fit_campaign
from sysid.workflows.inspect import print_log
from sysid.workflows.options import FitOptions
from sysid.workflows.report import open_report

_WIDTH = 96


def look_at_log(campaign: str | Path, trial: int = 0) -> Html:
    """Return what `sysid inspect` says and draws of the log of a campaign's trial."""
    stated = read_campaign(campaign)
    path = resolve_log(campaign, stated.trials[trial].log)
    recording = load_stated(path, stated.every_log.format, stated.every_log.loader_options())
    report = inspect_recording(recording)
    text = io.StringIO()
    # Inside a notebook rich would show every line by itself instead of writing it, with codes of colours.
    console = Console(
        file=text, width=_WIDTH, soft_wrap=True, force_jupyter=False, force_terminal=False, color_system=None
    )
    print_log(console, report)
    figure = figure_logs([recording], [report], width=WIDTH)
    words = f"channels of {path.name} over time: {', '.join(channel.name for channel in report.channels[:8])}"
    return preformatted(text.getvalue()) + picture(figure, words, f"{path.name}, as recorded.", vector=False)


def campaign_text(campaign: str | Path) -> Html:
    """Return the text of a campaign file."""
    return preformatted(Path(campaign).read_text(encoding="utf-8"))


def first_fit(
    campaign: str | Path, out: str | Path, *, runs: int | None = None, max_generations: int | None = None
) -> FitReport:
    """Fit a campaign, replacing the content of the folder `out`, and return the parts of its report.

    `runs` and `max_generations` cut the search short; the campaign states them otherwise.
    """
    options = FitOptions(
        Path(out), force=True, quiet=True, runs=runs, max_generations=max_generations,
        finish="none" if max_generations is not None else None, trust=max_generations is None,
    )  # fmt: skip
    return open_report(fit_campaign(campaign, options)[1])
