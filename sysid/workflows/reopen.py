"""A fit folder opened again with its campaign: the same free parameters, trials and cost as the fit had."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from sysid.errors import FitError, SysidError
from sysid.export import read_judged_fit
from sysid.fit.kind import Kind, Term
from sysid.fit.problem import Problem
from sysid.fit.provenance import CampaignFile
from sysid.fit.result import FitResult
from sysid.fit.store import fit_folder
from sysid.journal import notice
from sysid.parameters import SearchSpace
from sysid.synthetic.folder import read_truth
from sysid.workflows.kinds import naming_campaign, open_campaign


def shown_from_here(path: Path) -> Path:
    """Return a path without the steps back in it, from the current folder where it lies in that."""
    path = path.parent.resolve() / path.name
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


@dataclass(frozen=True, eq=False)
class OpenedFit:
    """A fit with its campaign file and all trials of the campaign, taken under the law of the fit."""

    folder: Path
    result: FitResult
    path: Path
    kind: Kind
    whole: Problem

    @cached_property
    def problem(self) -> Problem:
        """The fitted trials as the search saw them, simulated as exactly as trust needs it."""
        return self.whole.fitted.exact

    @property
    def truth(self) -> dict[str, float]:
        """True values by parameter [SI], where the campaign was synthesized."""
        try:
            return dict(read_truth(self.path)["parameters"])
        except SysidError:
            return {}

    @property
    def stated(self) -> CampaignFile:
        """Name and hash of the campaign file as it was read."""
        return {"file": self.path.name, "sha256": self.whole.campaign.source.sha256}

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the kind that the fit has not."""
        return tuple(t for t in self.kind.terms if not set(t.parameters) <= set(self.space.names))

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        return self.whole.space


def open_fit(folder: Path, campaign: Path | None = None, threads: int | None = None) -> OpenedFit:
    """Read a fit folder and prepare the trials that it was fitted to.

    Raises `SysidError` when the fit or its campaign cannot be read, or the campaign frees other parameters
    than the fit.
    """
    folder = fit_folder(Path(folder))
    return reopen(folder, read_judged_fit(folder), campaign, threads)


def reopen(folder: Path, result: FitResult, campaign: Path | None, threads: int | None) -> OpenedFit:
    """Prepare the trials of a fit that has been read, as `open_fit` does."""
    if not len(result.nrmse):
        raise FitError(f"{folder}: has no set; run the fit again")
    stated = result.provenance.get("campaign", {})
    path = campaign
    if path is None and (stored := stated.get("from_fit_folder")):
        path = shown_from_here(folder / stored)
    if path is None or not path.is_file():
        if campaign is not None:
            raise FitError(f"{campaign}: no such campaign file; --campaign names the one of the fit {folder}")
        name = f"its campaign {stated['file']!r} is not where it was" if stated else "it names no campaign"
        raise FitError(
            f"{folder}: {name}; put it back, or name it with --campaign (trust, explain, validate)"
        )
    with naming_campaign(path):
        kind, content, _ = open_campaign(path, result.kind, result.law)
        if stated.get("sha256") not in (None, content.source.sha256):
            notice(
                "campaign-changed",
                f"{path} has changed since the fit {folder} (another SHA-256): what follows is about the "
                "file as it is now",
            )
        opened = OpenedFit(folder, result, path, kind, kind.open(content, path, threads))
    names = opened.space.names
    fitted = tuple(r.name for r in result.searched or result.parameters if r.name in names)
    if names != fitted or len(names) != result.cube.shape[1]:
        raise FitError(
            f"{path}: frees {', '.join(names)}, which are not the {result.cube.shape[1]} free parameters of "
            f"{folder}; run the fit again, or name the campaign of the fit with --campaign"
        )
    return opened
