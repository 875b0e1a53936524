"""The kinds of models that the verbs know: landing gears, motors, and what else is registered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from sysid.campaign import read_campaign, register_campaign
from sysid.errors import CampaignError, CampaignFileError, SysidError, UnitError
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

    Examples
    --------
    A model is a table of parameters, a campaign and a problem. This one decays from 1:

    >>> from dataclasses import dataclass, replace
    >>> from functools import cached_property
    >>> from pathlib import Path
    >>> from typing import Literal
    >>> import numpy as np
    >>> import sysid
    >>> from sysid.campaign import FitTable
    >>> from sysid.campaign.common import CampaignTable, TomlTable, TrialTable
    >>> from sysid.fit.nrmse import CostChannel, FilteredNrmse, TrialTarget
    >>> from sysid.fit.problem import Problem
    >>> from sysid.fit.trial import Prediction, Trial
    >>> from sysid.parameters import Parameter, ParameterTable
    >>> from sysid.recording import file_sha256
    >>> rate = Parameter("decay_rate", "λ", "1/s", 1.0, 0.1, 10.0, "log", "Share lost per second.", "guess")
    >>> class Cost(TomlTable):
    ...     denominator: Literal["std", "range"] = "std"
    >>> class DecayCampaign(CampaignTable):
    ...     kind: Literal["decay"]
    ...     cost: Cost = Cost()
    ...     fit: FitTable = FitTable()
    ...     trials: tuple[TrialTable, ...]
    >>> @dataclass(frozen=True, eq=False)
    ... class Decay(Problem):
    ...     campaign: DecayCampaign
    ...     space: object
    ...     prepared: tuple
    ...     trials = property(lambda self: self.prepared)
    ...     noise = property(lambda self: np.full((len(self.trials), 1), 0.01))
    ...     @cached_property
    ...     def cost(self):
    ...         targets = [TrialTarget(trial.name, trial.measured) for trial in self.trials]
    ...         return FilteredNrmse(targets, [CostChannel("level", "1", 0)], self.campaign.cost.denominator)
    ...     def only(self, names):
    ...         return replace(self, prepared=tuple(t for t in self.prepared if t.name in names))
    ...     def predict(self, rows):
    ...         signals = tuple(np.exp(-rows[:, :1] * trial.time)[:, :, None] for trial in self.trials)
    ...         by_channel, failed = self.cost(np.concatenate(signals, axis=1))
    ...         return Prediction(by_channel, failed.astype(np.int8), signals)
    >>> def read(campaign, path, threads):
    ...     trials = []
    ...     for entry in campaign.trials:
    ...         log = Path(path).parent / entry.log
    ...         time, level = np.loadtxt(log, delimiter=",", unpack=True)
    ...         record = {"log": entry.log, "sha256": file_sha256(log)}
    ...         valid = np.ones((time.size, 1), bool)
    ...         trials.append(Trial(entry.name, entry.use, time, level[:, None], valid, record, 0.0))
    ...     space = campaign.parameters.search_space(ParameterTable([rate]), ("decay_rate",), {})
    ...     return Decay(campaign, space, tuple(trials))
    >>> sysid.register(sysid.Kind("decay", DecayCampaign, read))

    Its campaigns are fitted like all others:

    >>> time = np.arange(100) / 100
    >>> level = np.exp(-3.0 * time) + 0.01 * np.random.default_rng(1).standard_normal(100)
    >>> np.savetxt("decay.csv", np.column_stack([time, level]), delimiter=",")
    >>> lines = 'kind = "decay"', 'name = "d"', 'trials = [{ name = "a", log = "decay.csv" }]'
    >>> _ = Path("decay.toml").write_text(chr(10).join(lines))
    >>> sysid.Campaign.read("decay.toml").check()
    <Judgement of 1 parameters: 1 well; warnings: 0>
    >>> fit = sysid.fit_campaign("decay.toml", runs=2, population=16, max_generations=30)
    >>> low, high = fit.table.loc["decay_rate", ["interval_low", "interval_high"]]
    >>> low < 3.0 < high
    True
    """
    if not isinstance(kind, Kind):
        raise SysidError(f"expected a sysid.Kind to register, found {kind!r:.60}")
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
