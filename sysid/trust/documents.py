"""What is known about a fit's trustworthiness, stored beside it: ``NAME.json`` and ``NAME.h5`` in the fit
folder.

Three documents, each with the keys ``schema`` ("sysid-trust"), ``version`` (1), ``part``, ``fit`` (name),
``kind``, ``fit_sha256`` (of the ``fit.h5`` that it speaks of), ``written`` (UTC) and ``warnings``
(sentences). Units are SI, shares are 1, unknown numbers are "NaN" (`sysid.exact_json`). Arrays of the same
names lie in the HDF5 file, every dataset with the attributes ``axes`` and ``unit``.

``trust`` (one per fit)
    ``parameters``: list, one per free parameter, in the order of the fit:

    ====================  ====================================================================================
    name, symbol, unit    as everywhere
    lower, upper, scale   bounds of the search
    value                 of the best set
    refined               where the sum of squares is least at the accuracy of trust; differs from `value` by
                          less than the interval, or a warning says so
    mean, sigma           over the fit's sets (Table II)
    fisher_sigma          linearized standard deviation (relative for a logarithmic scale times the value, so
                          always in `unit`)
    derivative_doubt      share by which the derivative changes when its step is halved
    derivative_trusted    false from a tenth on
    interval_68/95        [low, high] of the profile; a bound of the search where open
    open_68/95            [low is open, high is open]
    half_width            half of interval_95 over the profile's best value; Infinity where open
    verdict               "well" below 0.1, "weakly" below 0.5, "not identifiable" beyond; never "well" where
                          there is a doubt
    doubt                 why the interval may not hold the truth: the best set is elsewhere, or one trial
                          decides; null: no reason known
    expected_half_width   the same from the linearization (what `sysid check` tells before a fit)
    partners              list of {"name", "correlation"}, the strongest first, from 0.8 on
    at_bound              -1, 0, 1: the best set ends within 1 % of a bound
    measured              [low, high] of the campaign's independent measurement, or null
    bootstrap_95          [low, high], or null where there was none
    rough_points          points of the profile that needed a random search
    ====================  ====================================================================================

    ``correlation``: (n, n). ``noise``: {"statement", "channels": list of {"name", "unit", "residual",
    "floor", "samples", "independent_samples"}}: rms of the residuals and of the measurement's own noise
    [unit], or NaN. ``spread``: {"channels", "units", "trials": list of {"name", "use", "rms", "largest"}}: of
    the predictions of all sets around their mean, one number per channel. ``bootstrap``: {"resamples",
    "failed"} or null; the failed ones are not in `bootstrap_95`. ``trials``: list of {"name", "ratio"
    (residual over what noise alone costs), "without" ({parameter: value of the fit without it}), "shift"
    ({parameter: how far that is, in standard deviations of what one trial less explains})}. ``notes``:
    sentences on what the numbers leave out. ``campaign``: {"file", "sha256"}. ``evaluations``, ``seconds``.

    HDF5: ``correlation``, ``covariance`` (unit cube), ``profiles/NAME/{value, deviance, others}`` (ascending
    values; deviance is chi-square-like, limits 0.989 and 3.841; others (k, n) are all free parameters),
    ``bootstrap/values`` (B, n).

``validation-CAMPAIGN`` (of a second file of that name ``validation-CAMPAIGN-HASH``) and ``cross-validation``
    ``campaign``: {"file", "sha256"}, of a validation also "from_fit_folder" (its path). ``flagged``: true
    where the prediction is off by more than the limit; ``reasons``: sentences that name the number.
    ``ratio``, ``ratio_third_contact``: means over the trials. ``limits``: {number: limit}. ``nrmse``:
    mean of the best set over all trials; ``nrmse_fitted``: of the fit. ``trials``: list of

    ====================  ====================================================================================
    name, slope_deg       slope only of drops
    nrmse                 mean over channels of each set, best first; in cross-validation of the one refit
    by_channel            {channel: NRMSE of the best set}
    floor                 what the measurement's noise alone would cost, mean over channels; NaN if unknown
    ratio                 nrmse of the best set over the floor
    nrmse_third_contact   best set up to its third touchdown, ratio_third_contact over the floor there; null
                          for motors
    third_contact         [s] after the first touchdown, or null
    leaves                {"time" [s since the first touchdown or the window's start], "channel",
                          "after_contacts"} of the first of three samples in a row beyond `limits.leaves`
                          noise deviations; null: never
    stop                  of drops: {"place": {measured, mean, sigma}, "time": ..., "measured_stops",
                          "share_stops"} [m] down-slope and [s], both since the first touchdown, over the sets
                          with starts drawn from their uncertainty; null for motors
    refit                 cross-validation: {parameter: value without this trial}
    ====================  ====================================================================================

    HDF5: ``trials/NUMBER/{time, measured, valid, simulated}`` (in order, from 1) as in ``fit.h5``; for
    cross-validation ``values`` (T, n).
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sysid import exact_json
from sysid.errors import FitError
from sysid.storage import write_file

SCHEMA, VERSION = "sysid-trust", 1
TRUST, CROSS_VALIDATION, VALIDATION = "trust", "cross-validation", "validation-"


def fit_digest(folder: Path) -> str:
    """Return the SHA-256 of a fit folder's ``fit.h5``."""
    return hashlib.sha256((folder / "fit.h5").read_bytes()).hexdigest()


def write_part(
    folder: Path,
    part: str,
    document: Mapping[str, Any],
    arrays: Mapping[str, tuple[Any, str, str]],
    *,
    fit: str,
    kind: str,
) -> Path:
    """Write one document and its arrays into a fit folder, in place of an earlier one.

    Parameters
    ----------
    folder : Path
        Of the fit.
    part : str
        ``trust``, ``cross-validation`` or ``validation-CAMPAIGN``.
    document : mapping
        See the module.
    arrays : mapping
        By path in the HDF5 file: (values, axes, unit).
    fit, kind : str
        Name and model of the fit.

    Raises
    ------
    FitError
        When it cannot be written; what was there is unchanged then.
    """
    whole = {
        "schema": SCHEMA,
        "version": VERSION,
        "part": part,
        "fit": fit,
        "kind": kind,
        "fit_sha256": fit_digest(folder),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        **document,
    }
    numbers = io.BytesIO()
    with h5py.File(numbers, "w") as file:
        file.attrs["schema"], file.attrs["version"], file.attrs["part"] = SCHEMA, VERSION, part
        for path, (values, axes, unit) in arrays.items():
            data = np.asarray(values)
            packed = {"compression": "gzip", "shuffle": True} if data.size > 64 else {}
            dataset = file.create_dataset(path, data=data, **packed)
            dataset.attrs["axes"], dataset.attrs["unit"] = axes, unit
    text = exact_json.dumps(whole) + "\n"
    target = folder / f"{part}.json"
    write_file(folder / f"{part}.h5", numbers.getvalue(), FitError)
    write_file(target, text.encode("utf-8"), FitError)
    return target


def read_part(folder: Path, part: str) -> dict[str, Any] | None:
    """Return a document of a fit folder; None where there is none, or where the fit has changed since.

    Raises
    ------
    FitError
        When it is damaged or of another version.
    """
    path = folder / f"{part}.json"
    if not path.is_file():
        return None
    try:
        document: dict[str, Any] = exact_json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA or document["version"] != VERSION:
            raise FitError(f"{path}: schema {document['schema']!r} {document['version']!r}; run it again")
        stale = document["fit_sha256"] != fit_digest(folder)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FitError(f"{path}: damaged or cut off ({error}); run it again") from error
    return None if stale else document


def read_arrays(folder: Path, part: str) -> dict[str, Any]:
    """Return the arrays of a document, by their path in the HDF5 file.

    Raises
    ------
    FitError
        When the file is missing or damaged.
    """
    out: dict[str, Any] = {}
    path = folder / f"{part}.h5"

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            out[name] = item[()]

    try:
        with h5py.File(path, "r") as file:
            file.visititems(take)
    except (OSError, KeyError, RuntimeError) as error:
        raise FitError(f"{path}: missing, damaged or cut off ({error}); run it again") from error
    return out


def parts(folder: Path) -> tuple[str, ...]:
    """Return which documents a fit folder holds, whether or not the fit has changed since."""
    found = sorted(path.stem for path in folder.glob("*.json") if (folder / f"{path.stem}.h5").is_file())
    return tuple(name for name in found if name in (TRUST, CROSS_VALIDATION) or name.startswith(VALIDATION))


def free_part(folder: Path, part: str, campaign: Mapping[str, str]) -> str:
    """Return the name under which a campaign's validation replaces its own and not that of another file.

    Parameters
    ----------
    folder : Path
        Of the fit.
    part : str
        `validation_part` of the campaign's name.
    campaign : mapping
        ``campaign`` of the document to be written. A file that was edited lies where it lay, one that was
        moved has the content it had: either is the same campaign. For another one, part of its hash is added.
    """
    hashed = re.compile(re.escape(part) + "-[0-9a-f]{8}")
    there = {}
    for name in parts(folder):
        if name == part or hashed.fullmatch(name):
            try:
                found = read_part(folder, name)
            except FitError:
                continue
            if found is not None:
                there[name] = found["campaign"]
    for key in ("from_fit_folder", "sha256"):
        same = [name for name, one in there.items() if one.get(key, "") == campaign.get(key)]
        if same:
            return same[0]
    return part if part not in there else f"{part}-{campaign['sha256'][:8]}"


def validation_part(campaign: str) -> str:
    """Return the name of a campaign's validation; what a file cannot be called is replaced."""
    return VALIDATION + re.sub(r"[^A-Za-z0-9._-]", "-", campaign)
