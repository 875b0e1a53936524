"""Which report shows which kind of fit; a kind that is not listed has the sections that every fit has."""

from __future__ import annotations

from pathlib import Path

from sysid.fit.store import read_fit
from sysid.report.fit_report import FitReport
from sysid.report.gear_report import GearReport
from sysid.report.motor_report import MotorReport

REPORTS: dict[str, type[FitReport]] = {"gear": GearReport, "motor": MotorReport}


def open_fit(fit: str | Path, against: str | Path | None = None) -> FitReport:
    """Read a fit for its report; `against` is a folder with the same sets on trials of another campaign.

    Raises
    ------
    FitError
        When there is no fit.
    """
    folder, result = Path(fit), read_fit(fit)
    report = REPORTS.get(result.kind, FitReport)
    return report(
        folder if folder.is_dir() else folder.parent, result, read_fit(against) if against else None
    )
