"""The kinds of models that the verbs know: landing gears, motors, and those of `sysid.model`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from sysid.campaign import read_campaign, register_campaign
from sysid.campaign.file import refuse_repeated_logs
from sysid.errors import CampaignError, CampaignFileError, UnitError
from sysid.fit.kind import Kind
from sysid.gear.kind import GEAR
from sysid.journal import Finding
from sysid.motor.kind import MOTOR

_ANY_REPORT = "sysid.report.fit_report:FitReport"
_KINDS: dict[str, Kind] = {}
_REPORTS: dict[str, str] = {}


def register(kind: Kind, report: str = _ANY_REPORT) -> None:
    """Let every verb serve a kind of model: check, fit, trust, validate, report, export.

    `report` names the class that shows its fits, ``module:class``; only `find_report` imports the module.
    """
    _KINDS[kind.name], _REPORTS[kind.name] = kind, report
    register_campaign(kind.name, kind.campaign)


register(GEAR, "sysid.report.gear_report:GearReport")
register(MOTOR, "sysid.report.motor_report:MotorReport")


def find_report(name: str) -> Any:
    """Return the class of the report of a kind; an unknown kind has the sections that every fit has."""
    return resolve_name(_REPORTS.get(name, _ANY_REPORT))


def find_kind(name: str) -> Kind:
    """Return a kind by its name."""
    return _KINDS[name]


def open_campaign(
    path: str | Path,
    kind: str | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    law: Mapping[str, Any] | None = None,
) -> tuple[Kind, Any, tuple[Finding, ...]]:
    """Return the kind of a campaign file, its content, and what is noticed about it.

    Another `kind` than the one named is refused. With the `settings` of a fit, such as ``{"surface": "hf"}``,
    the campaign is taken under the law of that fit; what it states and that law ignores is noticed. A `law`
    that the user states does the same, and is refused where the kind does not know it. With
    ``{"exact": True}`` in either, or in the campaign's ``[fit]``, every stated value is exact.
    """
    law = law or {}
    chosen = {**(settings or {}), **law}
    campaign = read_campaign(path, kind if settings is None else None, exact=chosen.get("exact"))
    if settings is not None and kind not in (None, campaign.kind):
        raise CampaignFileError(
            f"{path}: is a {campaign.kind} campaign, but the fit is a {kind} fit; name a {kind} campaign"
        )
    refuse_repeated_logs(campaign, path)
    model = find_kind(campaign.kind)
    for name in law:
        if name not in (*model.laws, "exact"):
            lacks = f"a campaign of kind {campaign.kind!r} has no {name}"
            raise CampaignFileError(f"{path}: {lacks}; leave --{name} out")
    with naming_campaign(path):
        campaign, ignored = model.under(campaign, chosen)
    return model, campaign, ignored


@contextmanager
def naming_campaign(path: str | Path) -> Iterator[None]:
    """Put the campaign's path before a refusal of its content that does not name it yet."""
    try:
        yield
    except CampaignFileError:
        raise
    except (CampaignError, UnitError) as error:
        raise CampaignFileError(f"{path}: {error}") from error
