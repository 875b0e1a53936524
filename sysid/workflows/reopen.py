"""A fit folder opened again with its campaign: the same free parameters, trials and cost as the fit had."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign, MotorCampaign, read_campaign
from sysid.errors import FitError, SysidWarning
from sysid.fit.result import FitResult
from sysid.fit.store import read_fit
from sysid.gear import problem as gear
from sysid.gear.drops import PreparedDrop, prepare_drops
from sysid.gear.trust import TRUST_TOLERANCE, GearProblem
from sysid.motor import known_values as motor_bench
from sysid.motor.known_values import Bench, prepare_bench
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.motor.objective import MotorObjective
from sysid.motor.trust import MotorProblem, bench_floors
from sysid.parameters import SearchSpace
from sysid.recording import file_sha256
from sysid.workflows.search import naming


def fit_folder(path: Path) -> Path:
    """Return a fit's folder, also of the file in it that holds the sets."""
    return path.parent if path.name == "fit.h5" else path


def campaign_of(result: FitResult, folder: Path, given: Path | None) -> Path:
    """Return the campaign file of a fit: given, or where it lay when the fit was made.

    Raises
    ------
    FitError
        When it is not there.

    Warns
    -----
    SysidWarning
        When it is not the file that was fitted.
    """
    said = result.provenance.get("campaign", {})
    path = given
    if path is None:
        stored = said.get("from_fit_folder")
        path = folder / stored if stored else None
    if path is None or not path.is_file():
        raise FitError(
            f"{folder}: its campaign {said.get('file', '')!r} is not where it was; name it with --campaign"
        )
    if said.get("sha256") not in (None, file_sha256(path)):
        warnings.warn(
            f"{path} has changed since the fit {folder} (another SHA-256): what follows speaks of the "
            "file as it is now",
            SysidWarning,
            stacklevel=2,
        )
    return path


@dataclass(frozen=True, eq=False)
class OpenedFit:
    """A fit and its campaign.

    Parameters
    ----------
    folder : Path
    result : FitResult
    path : Path
        Campaign file.
    campaign : GearCampaign or MotorCampaign
        With the friction law of the fit.
    problem : GearProblem or MotorProblem
        Of the fitted trials.
    drops : tuple of PreparedDrop
        All drops of a gear campaign.
    bench : Bench or None
        Of a motor campaign.
    """

    folder: Path
    result: FitResult
    path: Path
    campaign: GearCampaign | MotorCampaign
    problem: GearProblem | MotorProblem
    drops: tuple[PreparedDrop, ...] = ()
    bench: Bench | None = None

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        return self.problem.space


def open_fit(folder: Path, campaign: Path | None = None, threads: int | None = None) -> OpenedFit:
    """Read a fit folder and prepare the trials that it was fitted to.

    Raises
    ------
    SysidError
        When the fit or its campaign cannot be read, or the campaign frees other parameters than the fit.
    """
    folder = fit_folder(Path(folder))
    result = read_fit(folder)
    if not len(result.nrmse):
        raise FitError(f"{folder}: holds no set; run the fit again")
    path = campaign_of(result, folder, campaign)
    with naming(path):
        opened = _open_gear if result.kind == "gear" else _open_motor
        found = opened(folder, result, path, threads)
    if (
        found.space.names != tuple(r.name for r in result.parameters if r.name in found.space.names)
        or len(found.space.names) != result.cube.shape[1]
    ):
        raise FitError(
            f"{path}: frees {', '.join(found.space.names)}, which are not the {result.cube.shape[1]} free "
            f"parameters of {folder}; run the fit again, or name its own campaign with --campaign"
        )
    return found


def law_of(campaign: GearCampaign, law: str) -> GearCampaign:
    """Return a campaign on the friction law of a fit, without what it states of another surface."""
    return gear.on_surface(campaign, law)[0]


def gear_problem(
    campaign: GearCampaign, drops: tuple[PreparedDrop, ...], threads: int | None = None
) -> GearProblem:
    """Return the fitted drops of a campaign as residuals, simulated as exactly as trust needs it."""
    fitted = tuple(drop for drop in drops if drop.use == "fit")
    accuracy = min(TRUST_TOLERANCE, gear.fit_tolerance(campaign))
    space = gear.search_space(campaign)
    return GearProblem(gear.GearObjective.build(campaign, space, fitted, threads, accuracy))


def motor_problem(campaign: MotorCampaign, bench: Bench, threads: int | None = None) -> MotorProblem:
    """Return the trials of a motor's dynamic fit as residuals."""
    space = motor_bench.search_space(campaign, bench)
    objective = MotorObjective.build(campaign, space, bench, bench.fitted, threads, dynamic=True)
    return bench_problem(campaign, bench, objective)


def bench_problem(campaign: MotorCampaign, bench: Bench, objective: MotorObjective) -> MotorProblem:
    """Return the trials of an objective as residuals, with what its campaign says of the known values."""
    ranges = campaign.parameters.measured_ranges(MOTOR)
    # A curve that the campaign states is no fit to points.
    fits = tuple(f for f in bench.curves.fits if not {*f.parameters} & {*campaign.parameters.fixed})
    return MotorProblem(objective, fits, ranges)


def _open_gear(folder: Path, result: FitResult, path: Path, threads: int | None) -> OpenedFit:
    campaign = read_campaign(path, "gear")
    assert isinstance(campaign, GearCampaign)
    campaign = law_of(campaign, str(result.settings["surface"]))
    drops = prepare_drops(campaign, path)
    return OpenedFit(
        folder, result, path, campaign, gear_problem(campaign, drops, threads), drops=drops
    )  # fmt: skip


def _open_motor(folder: Path, result: FitResult, path: Path, threads: int | None) -> OpenedFit:
    campaign = read_campaign(path, "motor")
    assert isinstance(campaign, MotorCampaign)
    bench = prepare_bench(campaign, path)
    return OpenedFit(folder, result, path, campaign, motor_problem(campaign, bench, threads), bench=bench)


def table_rows(opened: OpenedFit, values: Any = None) -> np.ndarray:
    """Return the sets of a fit (S, n_table) as rows of its campaign's table [SI]."""
    result = opened.result
    index = {record.name: i for i, record in enumerate(result.parameters)}
    found = np.asarray(result.values if values is None else values)
    return np.ascontiguousarray(found[:, [index[name] for name in opened.space.table]])


def noise_floors(opened: OpenedFit, cube: np.ndarray) -> np.ndarray:
    """Return what noise alone costs, NRMSE of every block of a fit's trials (B,) [1].

    Of a bench with what the errors of the static curves and tares cost at a point of the unit cube (n,).
    """
    problem = opened.problem
    if isinstance(problem, MotorProblem):
        return bench_floors(problem, problem.space.full(np.atleast_2d(cube))[0])
    return np.array([block.noise for block in problem.blocks])
