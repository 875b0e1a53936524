"""Campaigns, stored files and calls of Python, as a process under limits opens them.

A reader returns the content of a file or folder; `worker` compares it with the content before the damage.
"""

import math
import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import BaseModel

import sysid
from fakes import lag_kind  # noqa: F401  the kind of a campaign
from fakes.places import PUBLISHED, SAMPLES
from fakes.slow_fit import IDENTITY
from sysid.campaign import read_campaign
from sysid.errors import SysidError
from sysid.fit.checkpoint import Checkpoint
from sysid.landing.store import read_maps, read_study
from sysid.trust.documents import TRUST, TrustDocument, read_arrays
from sysid.workflows.fits import list_fits
from sysid.workflows.kinds import naming_campaign, open_campaign


def leaves(value, place=""):
    """Yield numbers and texts of a content, each with its place."""
    if isinstance(value, BaseModel) or is_dataclass(value):
        names = type(value).model_fields if isinstance(value, BaseModel) else [f.name for f in fields(value)]
        value = {name: getattr(value, name) for name in names if name != "sha256"}
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from leaves(part, f"{place}/{key}")
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from leaves(part, f"{place}/{number}")
    elif isinstance(value, np.ndarray):
        yield place, (str(value.dtype), value.shape, value.tobytes())
    else:
        yield place, repr(value)


def _campaign(path):
    campaign = read_campaign(path)
    if campaign.kind != "lag":
        return campaign
    # Its logs are small enough to be opened each time.
    with naming_campaign(path):
        kind, content, _ = open_campaign(path)
        trials = kind.open(content, path, 1).trials
    return {"campaign": content, "trials": [trial.measured for trial in trials]}


def _fit(folder):
    fit = sysid.load_fit(folder)
    assert fit.verdict
    trust = TrustDocument.read(folder)
    states = [entry.state for entry in list_fits(folder.parent) if entry.name == folder.name]
    return [fit.result, trust, read_arrays(folder, TRUST) if trust else None, states]


def _checkpoint(folder):
    store = Checkpoint(str(folder).removesuffix(Checkpoint.SUFFIX), IDENTITY, resume=True)
    try:
        found = [store.finished(0, 0, "ga", 7), store.finished(0, 1, "cmaes", 7), store.best(0, 7)]
        if store.notes:
            raise SysidError(store.notes[0])
        return found
    finally:
        store.close()


# By the kind of what is opened: its reader.
READERS = {
    "campaign": _campaign, "fit": _fit, "sets": sysid.load_parameter_sets, "maps": read_maps,
    "study": read_study, "checkpoint": _checkpoint,
}  # fmt: skip


# --- calls of Python ----------------------------------------------------------------------------------------

GEAR, MOTOR = (PUBLISHED / f"published-{name}.json" for name in ("gear-lf", "motor"))
STUDY = {"slopes": (10.0, 20.0), "speeds": (0.4, 0.6), "threads": 1}
LIMITS = {"runs": 1, "population": 8, "max_generations": 2, "check": False, "trust": False, "force": True}
VALUES = (
    None, True, -1, 10**400, math.nan, math.inf, 1e308, "", "a\0b", "x" * 5000, b"x", [], {"a": 1}, object(),
)  # fmt: skip


@cache
def _sets(path):
    return sysid.load_parameter_sets(path)


def _fitted(**given):
    return sysid.fit_campaign(**{"campaign": Path("lag.toml"), "out": "fit", **LIMITS, **given})


DECAY = {
    "name": "decay", "simulate": lambda values, time, trial: np.exp(-values["rate"] * time), "inputs": {},
    "parameters": {"rate": (0.1, 10, "1/s")}, "channels": {"level": "V"}, "patience": 60.0,
    "vectorized": False,
}  # fmt: skip
DECAYS = {"one": pd.DataFrame({"level": np.exp(-np.arange(20) / 10)}, index=np.arange(20) / 10)}


def _bounded(low, high, unit):
    return sysid.model(**DECAY | {"parameters": {"rate": (low, high, unit)}})


def _stated(level, weight, load):
    one = sysid.model(**DECAY | {"inputs": {"load": "kg"}})
    one.campaign(DECAYS, noise={"level": level}, weights={"level": weight}, inputs={"one": {"load": load}})


# By name: a call, its arguments that are replaced one at a time, and the others.
CALLS = {
    "load_log": (sysid.load_log, {"path": SAMPLES / "motor/forward-1.csv", "format": "auto"}),
    "inspect": (sysid.inspect, {"path": SAMPLES / "motor/forward-1.csv"}),
    "load_fit": (sysid.load_fit, {"path": "fit"}),
    "load_parameter_sets": (sysid.load_parameter_sets, {"path": GEAR}),
    "Campaign.read": (sysid.Campaign.read, {"path": SAMPLES / "motor"}),
    "fit_campaign": (
        _fitted,
        {"campaign": Path("lag.toml"), "out": "fit", "runs": 1, "seed": 1, "time_limit": "1 min"},
    ),
    "validate": (sysid.validate, {"fit": "fit", "campaign": Path("lag.toml")}),
    "simulate_drop": (
        lambda **given: sysid.simulate_drop(_sets(GEAR), **{"slope": 0.3, "speed": 0.5, **given}),
        {"slope": 0.3, "speed": 0.5, "pitch_rate": 0.0, "rate": 1000.0, "change": "k_h=2"},
    ),
    "landing_map": (
        lambda **given: sysid.landing_map([GEAR], MOTOR, **{"check": False, **STUDY, **given}),
        {"slopes": (10.0, 20.0), "controllers": ("off",), "pair": "best", "draws": None},
    ),
    "design_study": (
        lambda **given: sysid.design_study(GEAR, MOTOR, **{"vary": "k_h=1:2:2", **STUDY, **given}),
        {"vary": "k_h=1:2:2", "share": 0.5, "spread": 0.0, "threads": 1},
    ),
    "static_limits": (sysid.static_limits, {"sets": GEAR, "thrust": (0.0, 12.0)}),
    "set_values": (lambda rank: _sets(GEAR).set_values(rank), {"rank": 1}),
    "save": (lambda path: _sets(GEAR).save(path, force=True), {"path": "sets.json"}),
    "numbers_for": (sysid.numbers_for, {"sets": MOTOR, "target": "gazebo", "rank": 1, "mass": "1.2 kg"}),
    "model": (sysid.model, DECAY),
    "bounds": (_bounded, {"low": 0.1, "high": 10.0, "unit": "1/s"}),
    "Model.campaign": (
        lambda **given: sysid.model(**DECAY).campaign(**given),
        {
            "trials": DECAYS, "inputs": {}, "validate": (), "noise": {}, "weights": {}, "folder": "own",
            "force": True,
        },
    ),
    "stated": (_stated, {"level": 0.01, "weight": 1.0, "load": "0.2 kg"}),
    "compare": (
        lambda other, cross: sysid.compare("fit", other, cross=cross), {"other": "fit", "cross": False}
    ),
    "cross_validate": (
        sysid.cross_validate, {"fit": "fit", "campaign": None, "threads": 1, "progress": False}
    ),
    "explain": (sysid.explain, {"fit": "fit", "campaign": None, "threads": 1}),
    "trial": (lambda name: sysid.load_fit("fit").trial(name), {"name": "one"}),
    "draws": (lambda count: sysid.load_fit("fit").draws(count), {"count": 10}),
    "report": (lambda **given: sysid.load_fit("fit").report(force=True, **given), {"out": "page.html"}),
}  # fmt: skip
ARGUMENTS = tuple((name, argument) for name, (_, given) in CALLS.items() for argument in given)


def called(name, argument, number, folder):
    """Call a function with one hostile argument; what it returns is of no interest."""
    os.chdir(folder)
    function, given = CALLS[name]
    function(**given | {argument: VALUES[number]})
