"""What ``import sysid`` offers: logs, campaigns, fits, sets and landings, by the verbs of the command line.

Nothing here prints. An input that cannot be used is a `sysid.SysidError` of one sentence.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import partial
from inspect import cleandoc, signature
from numbers import Integral, Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, get_args

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError

from sysid.campaign import read_campaign
from sysid.campaign.common import CampaignTable
from sysid.documents import mistake
from sysid.errors import CampaignError, FitError
from sysid.export import load_parameter_sets as load_parameter_sets
from sysid.export import read_judged_fit
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.store import fit_folder
from sysid.journal import Say
from sysid.loaders import load
from sysid.marks import Flag, field_hints, field_values, mark_of
from sysid.parameter_sets import ParameterSets, interval_columns
from sysid.recording import Recording
from sysid.report.explain import conclusion
from sysid.report.inspect_figures import figure_logs
from sysid.search_options import Algorithm, Finisher
from sysid.shown import Shown
from sysid.storage import path_of
from sysid.trials.look import LogReport, inspect_recording
from sysid.trust.comparison import Comparison
from sysid.trust.documents import (
    CheckDocument,
    CrossValidationDocument,
    ExplainDocument,
    FreeParameter,
    JudgedTrial,
    TrustDocument,
    ValidationDocument,
    with_intervals,
)
from sysid.units import in_si
from sysid.workflows import fit as fits
from sysid.workflows.check import check_campaign
from sysid.workflows.compare import compare_fits
from sysid.workflows.draws import drawn_sets
from sysid.workflows.explain import explain_opened
from sysid.workflows.options import FitOptions, ReportOptions, TrustOptions, campaign_file
from sysid.workflows.predict import cross_validate as leave_out
from sysid.workflows.predict import validate_fit
from sysid.workflows.reopen import open_fit
from sysid.workflows.report import write_report
from sysid.workflows.show import verdict_on
from sysid.workflows.trust import assess_fit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Options = TypeVar("Options")
Function = TypeVar("Function", bound=Callable[..., object])
Doc = TypeVar(
    "Doc",
    bound=CheckDocument | TrustDocument | ValidationDocument | CrossValidationDocument | ExplainDocument
    | Comparison,
    covariant=True,
)  # fmt: skip
# True: lines on standard error, as of a command. A function: it gets the lines.
Progress = bool | Callable[[str], None]
_DIFFERS = {True: "differs", False: "no difference", None: "not judged"}
# Largest whole number that is read [1]: a larger one has no place among floating-point numbers.
_LARGEST = 10**300


def documented(options: Any) -> Callable[[Function], Function]:
    """Return a decorator that adds to a docstring what the options of a command mean."""

    def add(function: Function) -> Function:
        marks = dict(_marks(options))
        names = [name for name in signature(function).parameters if name in marks]
        # A bare number is in SI.
        units = {"": "", "deg": " [rad, or a text such as '20 deg']"}
        lines = [
            f"{name} : {marks[name].help}{units.get(marks[name].unit, f' [{marks[name].unit}]')}"
            for name in names
        ]
        text = "\n".join(["Options", "-------", *lines])
        function.__doc__ = f"{cleandoc(function.__doc__ or '')}\n\n{text}\n"
        return function

    return add


def _marks(options: Any) -> Iterator[tuple[str, Flag]]:
    for name, hint in field_hints(options).items():
        if is_dataclass(hint):
            yield from _marks(hint)
        elif isinstance(mark := mark_of(hint), Flag):
            yield name, mark


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
    return Log(**vars(_loaded(path, format, options)))


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
    return inspect_recording(_loaded(path, format, options))


def _loaded(path: str | Path, format: str, options: Mapping[str, object]) -> Recording:
    """Return a recording; options may be numbers of numpy."""
    given = {name: plain(value) for name, value in options.items()}
    return load(path_of(path, "a log"), format=format, **given)


def plain(value: object) -> Any:
    """Return a number of numpy as one of Python, and anything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


class Judgement(Shown, Generic[Doc]):
    """What a verb says: a row per parameter, trial or term, sentences, warnings, and the whole `document`."""

    def __init__(self, document: Doc) -> None:
        self.document = document

    def __repr__(self) -> str:
        rows, what = self._rows()
        if not rows and self.sentences:
            return f"<Judgement: {self.sentences[0]}; warnings: {len(self.warnings)}>"
        words = Counter(str(row["verdict"]).replace("_", " ") for row in rows.values())
        counts = ", ".join(f"{count} {word}" for word, count in words.items())
        return f"<Judgement of {len(rows)} {what}s: {counts}; warnings: {len(self.warnings)}>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may be wrong, a sentence each."""
        return tuple(self.document.warnings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is concluded: advice, reasons, or how far noise explains a fit."""
        document = self.document
        if isinstance(document, ExplainDocument):
            return tuple(conclusion(document))
        if isinstance(document, CheckDocument | Comparison):
            return tuple(document.sentences)
        if isinstance(document, TrustDocument):
            return (document.adequacy.sentence,) if document.adequacy else ()
        use = getattr(document, "use", None)
        return (*document.reasons, *([use.sentence] if use is not None and use.sentence else []))

    @property
    def table(self) -> pd.DataFrame:
        """The same as `to_frame`."""
        return self.to_frame()

    def to_frame(self) -> pd.DataFrame:
        """Return a row per parameter [SI], predicted trial or term, each with a verdict.

        A half-width is half of the 95 % interval over the value.
        """
        import pandas as pd

        rows, what = self._rows()
        return pd.DataFrame([*rows.values()], index=pd.Index([*rows], name=what))

    @property
    def numbers(self) -> pd.DataFrame:
        """A row per trial and number of use that is predicted: measured, predicted, 95 % of the draws."""
        import pandas as pd

        trials = getattr(self.document, "trials", ())
        rows = [
            {"trial": trial.name, **number.model_dump(), "held": number.held}
            for trial in trials
            for number in getattr(trial, "numbers", ())
        ]
        columns = ["trial", "what", *([*rows[0]][1:] if rows else [])]
        return pd.DataFrame(rows, columns=[*dict.fromkeys(columns)]).set_index(["trial", "what"])

    def remarks(self) -> tuple[str, ...]:
        """Return sentences, then warnings."""
        return (*self.sentences, *self.warnings)

    def _rows(self) -> tuple[dict[str, dict[str, object]], str]:
        document: object = self.document
        rows: dict[str, dict[str, object]]
        if isinstance(document, CheckDocument | TrustDocument):
            rows = {
                row.name: {"symbol": row.symbol, "unit": row.unit, "value": row.value}
                | (
                    interval_columns(row)
                    if isinstance(row, FreeParameter)
                    else {"half-width / value": row.half_width, "verdict": row.verdict}
                )
                for row in document.parameters
            }
            return rows, "parameter"
        if isinstance(document, Comparison):
            rows = {
                row.parameter: {
                    "symbol": row.symbol,
                    "unit": row.unit,
                    **dict(zip(row.fits, row.values, strict=True)),
                }
                | {"difference": row.difference, "verdict": _DIFFERS[row.differs]}
                for row in document.differences
            }
            return rows, "parameter"
        if isinstance(document, ExplainDocument):
            verdicts = (
                (document.base, "as fitted"),
                *((rung, "too simple" if rung.kept else "as good") for rung in document.simpler),
                *((rung, "kept" if rung.kept else "not kept") for rung in document.alone),
            )
            rows = {
                " and ".join(rung.terms) or "as fitted": {"NRMSE": rung.nrmse, "over noise": rung.over_noise}
                | {"gain": rung.gain, "chance": rung.chance, "verdict": word}
                for rung, word in verdicts
            }
            return rows, "model"
        assert isinstance(document, ValidationDocument | CrossValidationDocument)
        rows = {
            trial.name: {"NRMSE": trial.nrmse[0], "over noise": trial.ratio}
            | {"beyond noise from [s]": trial.leaves.time if trial.leaves else math.nan}
            | {"verdict": _beside_noise(trial)}
            for trial in document.trials
        }
        return rows, "trial"


def _beside_noise(trial: JudgedTrial) -> str:
    if math.isnan(trial.ratio):
        return "not judged"
    return "beyond the noise" if trial.leaves else "within the noise"


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

    def __init__(
        self, path: Path, content: CampaignTable, kept: TemporaryDirectory[str] | None = None
    ) -> None:
        # A temporary folder lives as long as this object.
        self.path, self.content, self._kept = path, content, kept

    @classmethod
    def read(cls, path: str | Path, kept: TemporaryDirectory[str] | None = None) -> Self:
        """Read a campaign file, or the one in a folder; CampaignError when it cannot be used.

        A temporary folder that is `kept` lives as long as the campaign.
        """
        path = campaign_file(path_of(path, "a campaign"))
        return cls(path, read_campaign(path), kept)

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

    def check(self, *, surface: str | None = None, threads: int | None = None) -> Judgement[CheckDocument]:
        """Say before a fit what the trials will determine, and what to record next.

        `surface` overrides a gear campaign's friction law. The file is read again. Raises SysidError when
        an input cannot be used.
        """
        threads = python_options(TrustOptions, locals()).threads
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

    `result` has all arrays of the search, `folder` is where it lies, or None where none was kept; `place` is
    then a folder that ends with this object.

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

    def __init__(
        self, result: FitResult, folder: Path, kept: TemporaryDirectory[str] | None = None,
        campaign: object = None,
    ) -> None:  # fmt: skip
        # Temporary folders, of the campaign as well, live as long as this object.
        self.result, self.place, self._kept, self._campaign = result, folder, kept, campaign

    @property
    def folder(self) -> Path | None:
        """Folder of the fit."""
        return None if self._kept else self.place

    def __repr__(self) -> str:
        result = self.result
        count = len(result.nrmse)
        best = f"{count} set{'' if count == 1 else 's'}, best NRMSE {100 * result.nrmse[0]:.2f} %"
        where = "no folder kept" if self._kept else self.place.as_posix()
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
        absent = FitError(f"{self.result.name}: no trial {name!r}; found {', '.join(self.trials)}")
        raise absent.also(KeyError)

    @documented(TrustOptions)
    def trust(
        self, *, campaign: str | Path | None = None, resamples: int = 100, seed: int = 1,
        threads: int | None = None, dask: str | None = None, progress: Progress = False,
    ) -> Judgement[TrustDocument]:  # fmt: skip
        """Find the interval and verdict of every parameter, with a bootstrap over the trials.

        The result is kept in the folder, and `table` shows it. Raises SysidError when the campaign cannot be
        used.
        """
        document = assess_fit(self.place, python_options(TrustOptions, locals()), say_of(progress))
        self.result = with_intervals(read_judged_fit(self.place), self.place)
        return Judgement(document)

    def draws(self, count: int = 200) -> pd.DataFrame:
        """Return joint draws of what the data leave open: a row per draw, a column per number [SI].

        The fit stores 200; more are made from its campaign. FitError where the fit has no intervals.
        """
        import pandas as pd

        sets = drawn_sets(self.place, count)
        rows = pd.RangeIndex(1, len(sets) + 1, name="draw")
        return pd.DataFrame(sets.values, index=rows, columns=list(sets.names))

    @documented(ReportOptions)
    def report(
        self, out: str | Path | None = None, *, against: str | Path | None = None,
        compare: str | Path | None = None, figure: str | Path | None = None, gif: str | Path | None = None,
        mp4: str | Path | None = None, drop: str | None = None, force: bool = False,
    ) -> Path:  # fmt: skip
        """Write the report as one HTML page and return its path, by default ``report.html`` in the folder.

        Raises SysidError when something is missing or would be overwritten.
        """
        options = python_options(ReportOptions, locals())
        if out is None and self._kept:
            raise FitError(f"{self.result.name}: no folder was kept; name the page, as in report('fit.html')")
        return write_report(self.place, options)["report"]


def load_fit(path: str | Path) -> Fit:
    """Read a fit folder; FitError when it is missing, foreign or damaged."""
    path = path_of(path, "a fit")
    folder = fit_folder(path)
    return Fit(with_intervals(read_judged_fit(path), folder), folder)


@documented(FitOptions)
def fit_campaign(
    campaign: str | Path | Campaign, out: str | Path | None = None, *, kind: str | None = None,
    law: Mapping[str, object] | None = None,
    runs: int | None = None, population: int | None = None, seed: int | None = None,
    max_generations: int | None = None, algorithm: Algorithm | None = None, finish: Finisher | None = None,
    exact: bool | None = None, max_evaluations: int | None = None, time_limit: str | float | None = None,
    check: bool = True, trust: bool = True, force: bool = False, resume: bool = False,
    threads: int | None = None, dask: str | None = None, progress: Progress = False,
) -> Fit:  # fmt: skip
    """Fit the model of a campaign's kind to its trials.

    Ctrl-C ends the search and keeps what was found: the fit's state is then ``stopped``.

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
    progress : bool or function
        Show how far the fit is, on standard error; a function gets each line.

    Raises
    ------
    SysidError
        When an input cannot be used; nothing has been written then.
    """
    return _fitted(locals())


@documented(FitOptions)
def fit_gear(
    campaign: str | Path | Campaign, out: str | Path | None = None, *, surface: str | None = None,
    runs: int | None = None, population: int | None = None, seed: int | None = None,
    max_generations: int | None = None, algorithm: Algorithm | None = None, finish: Finisher | None = None,
    exact: bool | None = None, max_evaluations: int | None = None, time_limit: str | float | None = None,
    check: bool = True, trust: bool = True, force: bool = False, resume: bool = False,
    threads: int | None = None, dask: str | None = None, progress: Progress = False,
) -> Fit:  # fmt: skip
    """Fit a landing gear to drops, see `fit_campaign`.

    `surface` is another friction law than the campaign's.
    """
    law = {} if surface is None else {"surface": surface}
    return _fitted({**locals(), "kind": "gear"})


@documented(FitOptions)
def fit_motor(
    campaign: str | Path | Campaign, out: str | Path | None = None, *,
    runs: int | None = None, population: int | None = None, seed: int | None = None,
    max_generations: int | None = None, algorithm: Algorithm | None = None, finish: Finisher | None = None,
    exact: bool | None = None, max_evaluations: int | None = None, time_limit: str | float | None = None,
    check: bool = True, trust: bool = True, force: bool = False, resume: bool = False,
    threads: int | None = None, dask: str | None = None, progress: Progress = False,
) -> Fit:  # fmt: skip
    """Fit a motor to bench logs, see `fit_campaign`."""
    return _fitted({**locals(), "kind": "motor", "law": {}})


def _fitted(given: Mapping[str, Any]) -> Fit:
    """Return the fit that the arguments of a function ask for."""
    path, out, progress = campaign_path(given["campaign"]), given["out"], given["progress"]
    limit, law = given["time_limit"], given["law"]
    if law is not None and not isinstance(law, Mapping):
        raise CampaignError(f"law = {law!r:.60}: expected a mapping such as {{'surface': 'hf'}}").also(
            TypeError
        )
    if not isinstance(limit, str | None) and not in_si(limit, "s", "time_limit") > 0:
        raise CampaignError(f"time_limit = {limit!r:.60}: expected a time above 0, in s").also(ValueError)
    if given["resume"] and out is None:
        raise FitError("resume = True: no folder was kept to go on with; name it as out").also(ValueError)
    kept = TemporaryDirectory(prefix="sysid-") if out is None else None
    folder = Path(kept.name) / "fit" if kept else path_of(out, "the new fit folder")
    options = python_options(FitOptions, given, out=folder, quiet=not progress, details=True)
    say = say_of(progress)
    hear = None if isinstance(progress, bool) else say
    result, written = fits.fit_campaign(
        path, options, kind=given["kind"], law=given["law"], say=say, hear=hear
    )
    return Fit(result, written, kept, given["campaign"])


def say_of(progress: Progress) -> Say:
    """Return what takes sentences while a verb works."""
    if isinstance(progress, bool):
        return partial(print, file=sys.stderr) if progress else None
    if not callable(progress):
        raise CampaignError(f"progress = {progress!r:.60}: expected True, False or a function").also(
            TypeError
        )
    return progress


def campaign_path(campaign: object) -> Path:
    """Return the file of a campaign, of its path or of the folder that holds it."""
    if isinstance(campaign, Campaign):
        return campaign.path
    return campaign_file(path_of(campaign, "a campaign"))


def place_of(fit: str | Path | Fit) -> Path:
    """Return the folder of a fit, or the path that a caller gives."""
    return fit.place if isinstance(fit, Fit) else path_of(fit, "a fit")


@documented(TrustOptions)
def validate(
    fit: str | Path | Fit, campaign: str | Path | Campaign, *, threads: int | None = None,
    progress: Progress = False,
) -> Judgement[ValidationDocument]:  # fmt: skip
    """Predict the trials of a campaign that a fit has not seen.

    Of the campaign that was fitted, the trials of use "validate" serve. The result is kept in the fit's
    folder. Raises SysidError when nothing is left to validate with.

    Examples
    --------
    >>> import sysid
    >>> taste = {"runs": 1, "population": 8, "max_generations": 2, "finish": "none", "trust": False}
    >>> fits = [sysid.fit_motor("data_samples/motor", seed=seed, **taste) for seed in (1, 2)]
    >>> sysid.validate(fits[0], "data_samples/motor").table.index.tolist()
    ['forward-2', 'reversal-2']
    >>> sysid.cross_validate(fits[0]).table.index.tolist()
    ['forward-1', 'reverse-1']
    >>> sysid.compare(*fits, cross=False)
    <Judgement of 5 parameters: 5 not judged; warnings: 0>
    >>> isinstance(sysid.explain(fits[0]), sysid.Judgement) and isinstance(fits[0], sysid.Fit)
    True
    """
    threads = python_options(TrustOptions, {"threads": threads}).threads
    path = campaign_path(campaign)
    return Judgement(validate_fit(place_of(fit), path, threads=threads, say=say_of(progress)))


@documented(TrustOptions)
def cross_validate(
    fit: str | Path | Fit, campaign: str | Path | Campaign | None = None, *, threads: int | None = None,
    dask: str | None = None, progress: Progress = False,
) -> Judgement[CrossValidationDocument]:  # fmt: skip
    """Leave out each trial of a fit in turn, fit the rest, predict it.

    The result is kept in the fit's folder. Raises SysidError when fewer than two trials were fitted.
    """
    path = None if campaign is None else campaign_path(campaign)
    options = python_options(TrustOptions, {**locals(), "campaign": path})
    return Judgement(leave_out(
        place_of(fit), options.campaign, threads=options.threads, dask=options.dask, say=say_of(progress)
    ))  # fmt: skip


@documented(TrustOptions)
def compare(
    *fits: str | Path | Fit, cross: bool = True, threads: int | None = None, progress: Progress = False
) -> Judgement[Comparison]:
    """Say which differences between two or more fits are real.

    With `cross`, every fit also predicts the trials of every other one: ``document.cross``. Raises SysidError
    for fits of several kinds.
    """
    threads = python_options(TrustOptions, locals()).threads
    places = [place_of(fit) for fit in fits]
    document, _ = compare_fits(places, cross=cross, threads=threads, say=say_of(progress))
    return Judgement(document)


@documented(TrustOptions)
def explain(
    fit: str | Path | Fit, campaign: str | Path | Campaign | None = None, *, threads: int | None = None,
    progress: Progress = False,
) -> Judgement[ExplainDocument]:  # fmt: skip
    """Say what a fit's campaign states wrongly, and which physics its model lacks, as ``sysid explain`` does.

    Tries stated values, exchanges and single trials first. To what they leave it adds each declared term,
    finds those to keep among all together, and judges them on trials left out. ``document.parameters`` are
    those to free in a campaign. Raises SysidError for a kind without terms, and for too few fitted trials.
    """
    path = None if campaign is None else campaign_path(campaign)
    options = python_options(TrustOptions, {**locals(), "campaign": path})
    opened = open_fit(place_of(fit), options.campaign, options.threads)
    return Judgement(explain_opened(opened, say_of(progress)))


def python_options(cls: type[Options], given: Mapping[str, object], **fixed: object) -> Options:
    """Return the options `cls` among the arguments of a call; texts are read as on a command line.

    Fields that are dataclasses themselves take theirs by the same names. `fixed` are fields that the caller
    may not state. Raises `CampaignError` for a value of another kind.
    """
    hints = {name: hint for name, hint in field_hints(cls).items() if name not in fixed}
    return cls(**field_values(hints, given, _checked), **fixed)


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
            raise CampaignError(f"{name}: expected a number of a few digits, found one of over 300").also(
                ValueError
            )
        if unit == "deg" and abs(value) > math.tau:
            raise CampaignError(
                f"{name} = {value:g}: a bare number is in rad; write {name} = '{value:g} deg'"
            ).also(ValueError)
    try:
        return TypeAdapter(hint, config=ConfigDict(strict=True, allow_inf_nan=False)).validate_python(value)
    except ValidationError as error:
        also = f"; a bare number is in SI, and a text such as '1 {unit}' has its unit" if unit else ""
        refusal = CampaignError(f"{name} = {value!r}: {mistake(error.errors()[0])}{also}")
        raise refusal.also(ValueError) from None
