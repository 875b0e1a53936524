"""What ``import sysid`` offers: logs, campaigns, fits, sets and landings, by the verbs of the command line.

Nothing here prints. An input that cannot be used is a `sysid.SysidError` of one sentence.
"""

from __future__ import annotations

import difflib
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import is_dataclass
from numbers import Integral, Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self, TypeVar, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from sysid.campaign import read_campaign
from sysid.campaign.common import CampaignTable
from sysid.documents import mistake
from sysid.errors import CampaignError, ExportError, FitError
from sysid.export import load_parameter_sets as load_parameter_sets
from sysid.fit.kind import Kind as Kind
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.store import fit_folder, read_fit
from sysid.landing.drone import drone
from sysid.landing.simulate import Landing
from sysid.loaders import load
from sysid.marks import Flag, field_hints, field_values, mark_of
from sysid.parameter_sets import ParameterSets, RankedSet, interval_columns
from sysid.recording import Recording
from sysid.report.inspect_figures import figure_logs
from sysid.shown import Shown
from sysid.storage import path_of
from sysid.trials.look import LogReport, inspect_recording
from sysid.trust.documents import CheckDocument, FreeParameter, TrustDocument, with_intervals
from sysid.workflows import fit as fits
from sysid.workflows.check import check_campaign
from sysid.workflows.kinds import register as register
from sysid.workflows.landing import controller_of, land_drone
from sysid.workflows.options import (
    FitOptions,
    ReportOptions,
    TouchdownOptions,
    TrustOptions,
    campaign_file,
)
from sysid.workflows.report import write_report
from sysid.workflows.show import verdict_on
from sysid.workflows.trust import assess_fit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Options = TypeVar("Options")
# Largest whole number that is read [1]: a larger one has no place among floating-point numbers.
_LARGEST = 10**300


class Log(Recording):
    """A recording as `load_log` returns it, with a picture."""

    def plot(self) -> Figure:
        """Return a figure of the main channels over time."""
        return figure_logs([self], [inspect_recording(self)])


def load_log(path: str | Path, *, format: str = "auto", **options: object) -> Log:
    """Read one log of any format: channels in SI, each on its own clock [s].

    Parameters
    ----------
    format : str
        Name of the format; ``"auto"`` judges by content.
    **options
        What the log does not state, such as ``rate="10 kHz"``; ``sysid formats`` lists them.

    Raises
    ------
    LogError
        One sentence with file, line and cause.

    Examples
    --------
    >>> import sysid
    >>> log = sysid.load_log("data_samples/motor/forward-1.csv")
    >>> log
    <Recording forward-1.csv (load-cell): command, speed, thrust, torque; 5 s>
    >>> log["speed"]
    <Channel speed [rad/s]: 50000 samples, 10000 Hz>
    >>> log.to_frame().columns.tolist()
    ['command [us]', 'speed [rad/s]', 'thrust [N]', 'torque [N·m]']
    """
    return Log(**vars(load(path_of(path, "a log"), format=format, **options)))


def inspect(path: str | Path, *, format: str = "auto", **options: object) -> LogReport:
    """Say what a log contains and what looks wrong in it; arguments and errors as for `load_log`.

    Examples
    --------
    >>> import sysid
    >>> report = sysid.inspect("data_samples/gear-lf/drop-1-5deg-0.50mps.csv")
    >>> report
    <LogReport drop-1-5deg-0.50mps.csv (motion-capture, motive-csv): 7 channels, 1.775 s, no suspicions>
    >>> round(report.drop.touchdown, 2)
    11.82
    """
    return inspect_recording(load(path_of(path, "a log"), format=format, **options))


class Judgement(Shown):
    """What `check` and `trust` say: a row per parameter, sentences, warnings, and the whole `document`."""

    def __init__(self, document: CheckDocument | TrustDocument) -> None:
        self.document = document

    def __repr__(self) -> str:
        verdicts = Counter(row.verdict.replace("_", " ") for row in self.document.parameters)
        counts = ", ".join(f"{count} {word}" for word, count in verdicts.items())
        return f"<Judgement of {verdicts.total()} parameters: {counts}; warnings: {len(self.warnings)}>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may be wrong, a sentence each."""
        return tuple(self.document.warnings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a check advises, or how far noise explains a fit."""
        if isinstance(self.document, CheckDocument):
            return tuple(self.document.sentences)
        return (self.document.adequacy.sentence,) if self.document.adequacy else ()

    @property
    def table(self) -> pd.DataFrame:
        """The same as `to_frame`."""
        return self.to_frame()

    def to_frame(self) -> pd.DataFrame:
        """Return symbol, unit, value, and the 95 % interval or relative half-width, and verdict [SI]."""
        import pandas as pd

        rows = [
            {"symbol": row.symbol, "unit": row.unit, "value": row.value}
            | (
                interval_columns(row)
                if isinstance(row, FreeParameter)
                else {"half_width": row.half_width, "verdict": row.verdict}
            )
            for row in self.document.parameters
        ]
        names = [row.name for row in self.document.parameters]
        return pd.DataFrame(rows, index=pd.Index(names, name="parameter"))

    def remarks(self) -> tuple[str, ...]:
        """Return sentences, then warnings."""
        return (*self.sentences, *self.warnings)


class Campaign:
    """A campaign file: what was measured and which logs are fitted; made by `read`.

    Examples
    --------
    >>> import sysid
    >>> campaign = sysid.Campaign.read("data_samples/motor")
    >>> campaign
    <Campaign synthetic-motor (motor): 5 trials in data_samples/motor/campaign.toml>
    >>> campaign.trials[:2]
    ('forward-1', 'reverse-1')
    """

    def __init__(self, path: Path, content: CampaignTable) -> None:
        self.path, self.content = path, content

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a campaign file, or the one in a folder; CampaignError when it cannot be used."""
        path = campaign_file(path_of(path, "a campaign"))
        return cls(path, read_campaign(path))

    def __repr__(self) -> str:
        return f"<Campaign {self.name} ({self.kind}): {len(self.trials)} trials in {self.path.as_posix()}>"

    @property
    def name(self) -> str:
        """As the file states it."""
        return self.content.name

    @property
    def kind(self) -> str:
        """``gear``, ``motor`` or a kind of yours."""
        return self.content.kind

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials."""
        return tuple(trial.name for trial in self.content.trials)

    def check(self, *, surface: str | None = None, threads: int | None = None) -> Judgement:
        """Say before a fit what the trials will determine, and what to record next.

        `surface` overrides a gear campaign's friction law. The file is read again. Raises SysidError when
        an input cannot be used.
        """
        threads = python_options(TrustOptions, {"threads": threads}).threads
        return Judgement(check_campaign(self.path, surface=surface, threads=threads))


class FitTrial(Shown):
    """One trial of a fit, measured and predicted."""

    def __init__(self, fit: FitResult, trial: TrialResult) -> None:
        self._fit, self._trial = fit, trial

    def __repr__(self) -> str:
        use = "fitted" if self._trial.use == "fit" else "held back"
        return f"<FitTrial {self._trial.name} of {self._fit.name}: {len(self._trial.time)} samples, {use}>"

    def to_frame(self, rank: int = 1) -> pd.DataFrame:
        """Return every channel as it was measured and as the set of a rank predicts it, over the time [s].

        Columns are pairs such as ``("speed [rad/s]", "predicted")``. A measured sample that the fit does not
        compare is NaN.
        """
        import numpy as np
        import pandas as pd

        fit, trial = self._fit, self._trial
        fit.parameter_sets().set_values(rank)  # refuses a rank that is not there
        measured = np.where(trial.valid, trial.measured, np.nan)
        columns = {
            (f"{name} [{unit}]", what): values[:, c]
            for c, (name, unit) in enumerate(zip(fit.channels, fit.channel_units, strict=True))
            for what, values in (("measured", measured), ("predicted", trial.simulated[rank - 1]))
        }
        return pd.DataFrame(columns, index=pd.Index(trial.time, name="time [s]"))


class Fit(Shown):
    """A fit: its sets, trials, trust and report.

    `result` has all arrays of the search, `folder` is where it lies, or None where none was kept.

    Examples
    --------
    A taste; a fit with the campaign's own settings takes about a minute:

    >>> import sysid
    >>> taste = {"runs": 1, "population": 8, "max_generations": 2, "finish": "none", "trust": False}
    >>> fit = sysid.fit_gear("data_samples/gear-lf", out="fits/taste", **taste)
    >>> fit
    <Fit synthetic-lf (gear, done): 1 set, best NRMSE ... %; fits/taste>
    >>> sysid.load_fit("fits/taste").table.loc["leg_axial_stiffness", ["symbol", "unit"]].tolist()
    ['k_h', 'N/m']
    >>> fit.trial("drop-1").to_frame()["x_B [m]"].columns.tolist()
    ['measured', 'predicted']
    >>> fit.report().as_posix()
    'fits/taste/report.html'
    >>> fit.sets.to_frame().loc["leg_length"].status
    'derived'
    """

    def __init__(self, result: FitResult, folder: Path, kept: TemporaryDirectory[str] | None = None) -> None:
        # A temporary folder lives as long as this object.
        self.result, self._folder, self._kept = result, folder, kept

    @property
    def folder(self) -> Path | None:
        """Folder of the fit."""
        return None if self._kept else self._folder

    def __repr__(self) -> str:
        result = self.result
        count = len(result.nrmse)
        best = f"{count} set{'' if count == 1 else 's'}, best NRMSE {100 * result.nrmse[0]:.2f} %"
        where = "no folder kept" if self._kept else self._folder.as_posix()
        return f"<Fit {result.name} ({result.kind}, {result.state}): {best}; {where}>"

    @property
    def sets(self) -> ParameterSets:
        """The ranked sets."""
        return self.result.parameter_sets()

    @property
    def verdict(self) -> str:
        """Whether noise explains the fit, and what the data leave open, in one sentence."""
        return verdict_on(self.result)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may be wrong, a sentence each."""
        return self.result.warnings

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials."""
        return tuple(trial.name for trial in self.result.trials)

    @property
    def table(self) -> pd.DataFrame:
        """Value of the best set, unit, 95 % interval and verdict of every free parameter [SI].

        The value is NaN where the data do not determine it; `sets` has what the simulators take.
        """
        import pandas as pd

        free = [row for row in self.result.known.values() if row.record.status == "free"]
        rows = [
            {"symbol": row.record.symbol, "value": math.nan if row.instead else row.values[0]}
            | {"unit": row.record.unit}
            | interval_columns(row.judged)
            for row in free
        ]
        return pd.DataFrame(rows, index=pd.Index([row.record.name for row in free], name="parameter"))

    def to_frame(self) -> pd.DataFrame:
        """Return `table`."""
        return self.table

    def remarks(self) -> tuple[str, ...]:
        """Return the verdict and the warnings."""
        return (self.verdict, *self.warnings)

    def trial(self, name: str) -> FitTrial:
        """Return a trial by name; FitError where the fit has none of that name."""
        for trial in self.result.trials:
            if trial.name == name:
                return FitTrial(self.result, trial)
        raise FitError(f"{self.result.name}: no trial {name!r}; found {', '.join(self.trials)}")

    def trust(self, **options: object) -> Judgement:
        """Find the interval and verdict of every parameter, with a bootstrap over the trials.

        `options` as of ``sysid trust``: ``resamples``, ``seed``, ``threads``, ``campaign``. The result
        is kept in the folder, and `table` shows it. Raises SysidError when the campaign cannot be used.
        """
        document = assess_fit(self._folder, python_options(TrustOptions, options))
        self.result = with_intervals(read_fit(self._folder), self._folder)
        return Judgement(document)

    def report(self, out: str | Path | None = None, **options: object) -> Path:
        """Write the report as one HTML page and return its path, by default ``report.html`` in the folder.

        `options` as of ``sysid report``: ``against``, ``figure``, ``gif``, ``drop``, ``force``. Raises
        SysidError when something is missing or would be overwritten.
        """
        if out is None and self._kept:
            raise FitError(f"{self.result.name}: no folder was kept; name the page, as in report('fit.html')")
        given = {**options, "out": None if out is None else path_of(out, "the page")}
        return write_report(self._folder, python_options(ReportOptions, given))["report"]


def load_fit(path: str | Path) -> Fit:
    """Read a fit folder; FitError when it is missing, foreign or damaged."""
    path = path_of(path, "a fit")
    folder = fit_folder(path)
    return Fit(with_intervals(read_fit(path), folder), folder)


def fit_campaign(
    campaign: str | Path | Campaign, out: str | Path | None = None, *, kind: str | None = None,
    law: Mapping[str, object] | None = None, **options: object,
) -> Fit:  # fmt: skip
    """Fit the model of a campaign's kind to its trials.

    Parameters
    ----------
    campaign : path or Campaign
        Campaign file, or the folder that holds it.
    out : path, optional
        Folder of the fit; without it none is kept.
    kind : str, optional
        The only kind that is accepted.
    law : mapping, optional
        Settings instead of the campaign's, such as ``{"surface": "hf"}``.
    **options
        As of the commands: ``runs``, ``seed``, ``population``, ``max_generations``, ``time_limit="20min"``,
        ``algorithm``, ``finish``, ``threads``, ``trust=False``, ``resume``, ``force``, ``dask``.

    Raises
    ------
    SysidError
        When an input cannot be used; nothing has been written then.
    """
    path = campaign.path if isinstance(campaign, Campaign) else campaign_file(path_of(campaign, "a campaign"))
    kept = TemporaryDirectory(prefix="sysid-") if out is None else None
    folder = Path(kept.name) / "fit" if kept else path_of(out, "the new fit folder")
    chosen = python_options(FitOptions, options, out=folder, quiet=True)
    result, written = fits.fit_campaign(path, chosen, kind=kind, law=law)
    return Fit(result, written, kept)


def fit_gear(
    campaign: str | Path | Campaign, out: str | Path | None = None, *, surface: str | None = None,
    **options: object,
) -> Fit:  # fmt: skip
    """Fit a landing gear to drops, see `fit_campaign`.

    `surface` is another friction law than the campaign's.
    """
    law = {} if surface is None else {"surface": surface}
    return fit_campaign(campaign, out, kind="gear", law=law, **options)


def fit_motor(campaign: str | Path | Campaign, out: str | Path | None = None, **options: object) -> Fit:
    """Fit a motor to bench logs, see `fit_campaign`."""
    return fit_campaign(campaign, out, kind="motor", law=None, **options)


def simulate_drop(gear: RankedSet, slope: str | float, speed: str | float, **options: object) -> Landing:
    """Simulate a drop without thrust, from the touchdown on.

    Parameters
    ----------
    gear : RankedSet
        Such as ``sets.best``.
    slope, speed : str or float
        Slope of the ground and vertical touchdown speed, with units; bare numbers are in rad and m/s.
    **options
        As of ``sysid simulate``: ``pitch``, ``pitch_rate``, ``horizontal_speed``, ``rate``, ``horizon``, and
        when a landing is over.

    Examples
    --------
    >>> import sysid
    >>> sets = sysid.load_parameter_sets("data_samples/published/published-gear-lf.json")
    >>> float(sets.best["k_h"])  # N/m
    6440.0
    >>> drop = sysid.simulate_drop(sets.best, slope="20 deg", speed="0.5 m/s")
    >>> drop
    <Landing (no thrust; 20 deg, 0.5 m/s, lf): other, 1.193 m>
    >>> drop.events[["event", "of"]].head(2).to_numpy().tolist()
    [['touchdown', 'rear'], ['lift_off', 'rear']]
    """
    fixed = {"controller": "off", "controller_file": None, "trigger": "contact", "height": None}
    chosen = python_options(TouchdownOptions, {"slope": slope, "speed": speed, **options}, **fixed)
    return land_drone(drone(_set(gear)), chosen, None)


def simulate_landing(
    gear: RankedSet, motor: RankedSet, slope: str | float, speed: str | float, controller: str = "reverse",
    *, ideal_reversal: bool = False, **options: object,
) -> Landing:  # fmt: skip
    """Simulate a landing with motors under a controller; other arguments as for `simulate_drop`.

    Parameters
    ----------
    motor : RankedSet
        Set of the motors.
    controller : str
        ``off``, ``reverse``, ``command:U``, ``impulse:delay=50ms,duration=0.1``, or one of yours.
    ideal_reversal : bool
        Let the motors reverse without delay.

    Examples
    --------
    >>> import sysid
    >>> gear = sysid.load_parameter_sets("data_samples/published/published-gear-lf.json")
    >>> motor = sysid.load_parameter_sets("data_samples/published/published-motor.json")
    >>> sysid.simulate_landing(gear.best, motor.best, slope="20 deg", speed="0.5 m/s")
    <Landing (reverse; 20 deg, 0.5 m/s, lf): short after 0.643 s, 0.204 m>
    """
    given = {"slope": slope, "speed": speed, "controller": controller, **options}
    chosen = python_options(TouchdownOptions, given)
    return land_drone(drone(_set(gear), _set(motor)), chosen, controller_of(chosen, ideal_reversal))


def _set(given: object) -> RankedSet:
    if isinstance(given, RankedSet):
        return given
    raise ExportError(f"expected one set of a fit, such as sets.best, found a {type(given).__name__}")


def python_options(cls: type[Options], given: Mapping[str, object], **fixed: object) -> Options:
    """Return the options `cls` of a call from Python: names are checked and texts read as on a command line.

    Fields that are dataclasses themselves take theirs by the same names. `fixed` are fields that the caller
    may not state. Raises `CampaignError` for an unknown name or a value of another kind.
    """
    hints = {name: hint for name, hint in field_hints(cls).items() if name not in fixed}
    known = sorted(_names(hints))
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
            raise CampaignError(f"no option {name!r}; {hint}")
    return cls(**field_values(hints, given, _checked), **fixed)


def _names(hints: Mapping[str, object]) -> set[str]:
    names: set[str] = set()
    for name, hint in hints.items():
        names |= _names(field_hints(hint)) if is_dataclass(hint) else {name}
    return names


def _checked(name: str, value: object, hint: Any) -> object:
    """Return the value of an option as Python states it: a text where the command line takes one."""
    mark, plain = mark_of(hint), get_args(hint)[0]
    unit = mark.unit if isinstance(mark, Flag) else ""
    if isinstance(value, str):
        if isinstance(mark, Flag) and (mark.read or unit):
            return mark.read(value, name) if mark.read else mark.quantity(value, name)
        if Path in (plain, *get_args(plain)):
            value = path_of(value, f"a file or folder for {name}")
    if isinstance(value, Real) and not isinstance(value, bool):
        # numpy's numbers too
        value = int(value) if isinstance(value, Integral) else float(value)
        if isinstance(value, int) and abs(value) > _LARGEST:
            raise CampaignError(f"{name}: expected a number of a few digits, found one of over 300")
        if unit == "deg" and abs(value) > math.tau:
            raise CampaignError(
                f"{name} = {value:g}: a bare number is in rad; write {name} = '{value:g} deg'"
            )
    try:
        return TypeAdapter(hint, config=ConfigDict(strict=True, allow_inf_nan=False)).validate_python(value)
    except ValidationError as error:
        also = f"; a bare number is in SI, and a text such as '1 {unit}' has its unit" if unit else ""
        raise CampaignError(f"{name} = {value!r}: {mistake(error.errors()[0])}{also}") from None
