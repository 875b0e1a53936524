"""What the golden record holds. Every touch of sysid is in this file: a move of modules changes it alone.

Each subject returns its values by level; `record.LEVELS` says how a level is compared and why.
"""

import hashlib
import json
import math
import os
import shutil
import sys
import tempfile
import warnings
from functools import cache
from importlib.metadata import version
from pathlib import Path

import h5py
import llvmlite.binding
import numpy as np
import typer.main
from typer.testing import CliRunner

from fakes.log_samples import DAMAGES, LOGS
from fakes.places import DATA as PUBLIC_LOGS
from fakes.places import PUBLISHED, SAMPLES
from sysid.campaign import read_campaign
from sysid.campaign.common import as_exact
from sysid.cli import app
from sysid.errors import SysidError
from sysid.gear.drops import prepare_drops
from sysid.gear.problem import GearProblem, gear_space
from sysid.loaders import load
from sysid.motor.known_values import motor_space, prepare_bench
from sysid.motor.problem import MotorProblem
from sysid.workflows.fit import fit_gear, fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.provenance import processor

CAMPAIGNS = {name: SAMPLES / name / "campaign.toml" for name in ("gear-lf", "gear-hf", "motor")}
SMALL = {"population": 16, "runs": 2, "max_generations": 4, "quiet": True, "check": False, "trust": False}
# Variables of the environment with which the same libraries may round otherwise.
_SWITCHES = ("NPY_", "OPENBLAS_", "NUMBA_CPU_")
_LIBRARIES = ("numpy", "numba", "llvmlite", "scipy", "pymoo", "cma", "pandas")
# Differ from one run or place to the next.
_VOLATILE = {
    "written", "git revision", "libraries", "python", "system", "processor", "cores", "sysid", "seconds",
    "wall_time", "from_fit_folder", "git_revision", "from the fit folder", "folder", "path", "age [s]",
}  # fmt: skip


def machine():
    """Return what equal bits depend on."""
    features = llvmlite.binding.get_host_cpu_features()
    return {
        "processor": processor(),
        "llvm processor": llvmlite.binding.get_host_cpu_name(),
        "llvm features": " ".join(sorted(name for name, there in features.items() if there)),
        "switches": {name: os.environ[name] for name in sorted(os.environ) if name.startswith(_SWITCHES)},
        "python": ".".join(map(str, sys.version_info[:2])),
        **{name: version(name) for name in _LIBRARIES},
    }


# --- how values are written ---------------------------------------------------------------------------------


def bits(values):
    """Return an array's numbers as hexadecimal text, which loses nothing."""
    values = np.asarray(values, dtype=np.float64)
    return [bits(row) for row in values] if values.ndim else float(values).hex()


def digest(values):
    """Return type, shape and SHA-256 of an array's bytes; every NaN counts as the same."""
    values = np.ascontiguousarray(values)
    if values.dtype.kind == "f":
        values = np.where(np.isnan(values), np.nan, values)
    return f"{values.dtype} {values.shape} {hashlib.sha256(values.tobytes()).hexdigest()}"


def moments(values):
    """Return two exactly rounded sums of an array's magnitudes, the second one aware of their order."""
    flat = np.abs(np.nan_to_num(np.asarray(values, dtype=np.float64))).ravel()
    return [math.fsum(flat), math.fsum(flat * (1 + np.arange(flat.size) % 97))]


def keys_of(document, place=""):
    """Return the paths of all keys below a JSON document, list indices collapsed."""
    if isinstance(document, list):
        return sorted({key for one in document for key in keys_of(one, f"{place}[]")})
    if not isinstance(document, dict):
        return []
    below = (key for name, one in document.items() for key in keys_of(one, f"{place}/{name}"))
    return sorted({*below, *(f"{place}/{name}" for name in document)})


def steady(value):
    """Return a JSON document without what differs between runs; prose, free to be rewritten, only counts."""
    if isinstance(value, dict):
        return {name: steady(one) for name, one in value.items() if name not in _VOLATILE}
    if isinstance(value, list):
        return [steady(one) for one in value]
    return "(prose)" if isinstance(value, str) and len(value.split()) > 4 else value


def verdicts_of(document):
    """Return the words under every key that names a verdict, in order."""
    if isinstance(document, list):
        return [word for one in document for word in verdicts_of(one)]
    if not isinstance(document, dict):
        return []
    return [
        word
        for name, one in document.items()
        for word in ([one] if "verdict" in name and isinstance(one, str) else verdicts_of(one))
    ]


# --- costs and fits -----------------------------------------------------------------------------------------


def _gear_objective(name):
    campaign = as_exact(read_campaign(CAMPAIGNS[name], "gear"))
    drops = tuple(drop for drop in prepare_drops(campaign, CAMPAIGNS[name]) if drop.use == "fit")
    objective = GearProblem(campaign, gear_space(campaign), drops)
    return objective, lambda rows: objective.score(rows).by_channel


def _motor_objective(name):
    campaign = as_exact(read_campaign(CAMPAIGNS[name], "motor"))
    bench = prepare_bench(campaign, CAMPAIGNS[name])
    objective = MotorProblem.build(campaign, motor_space(campaign, bench), bench, bench.trials).fitted
    return objective, lambda rows: objective.score(rows).by_channel


def costs(name):
    """Return cost, failure and NRMSE by trial and channel of 64 fixed rows of the unit cube."""
    objective, score = (_motor_objective if name == "motor" else _gear_objective)(name)
    cube = np.random.default_rng(20240607).random((64, len(objective.space.free)))
    found = objective.evaluate(cube)
    by_channel = score(objective.space.full(cube))
    return {
        "always": {"free": list(objective.space.names), "simulations": found.simulations},
        "benches" if name == "motor" else "drops": {
            "cost": bits(found.cost),
            "median NRMSE": bits(np.median(by_channel, axis=0)),
        },
        "here": {"failed": np.asarray(found.failed, dtype=int).tolist(), "NRMSE": digest(by_channel)},
    }


@cache
def _place():
    return tempfile.TemporaryDirectory(prefix="sysid-golden-")


def _fit(name, out, **more):
    options = FitOptions(out=out, **{**SMALL, **more})
    walk = fit_motor if name == "motor" else fit_gear
    return walk(CAMPAIGNS[name], options)


@cache
def small_fit(name):
    """Fit a sample campaign once per process: result and folder."""
    return _fit(name, Path(_place().name) / name, finish="none")


def own_copy(name):
    """Return a copy of a small fit's folder, as near to its campaign, that a command may write into."""
    folder = Path(tempfile.mkdtemp(dir=_place().name))
    folder.rmdir()
    return shutil.copytree(small_fit(name)[1], folder)


def told(result):
    """Return what a fit found, by level."""
    stages = [
        [run.seed, one.algorithm, len(one.cost), one.evaluations, one.simulations, one.stop_reason]
        for run in result.runs
        for one in run.stages
    ]
    return {
        "always": {"state": result.state, "parameters": [one.name for one in result.parameters]},
        "best": float(result.nrmse[0]),
        "here": {
            "stages": stages,
            "values": bits(result.values),
            "nrmse": bits(result.nrmse),
            "best by generation": [bits(run.best) for run in result.runs],
            "populations": [digest(one.cube) + digest(one.cost) for run in result.runs for one in run.stages],
            "trials": {one.name: [bits(one.nrmse), digest(one.simulated)] for one in result.trials},
            "warnings": len(result.warnings),
            "settings": steady(dict(result.settings)),
        },
    }


def fit(name):
    """Return what a small fit finds."""
    return told(small_fit(name)[0])


def resumed_fit():
    """Return what a fit with a finisher finds that its time limit has stopped and that was continued."""
    with tempfile.TemporaryDirectory() as folder:
        whole = told(_fit("gear-lf", Path(folder) / "whole")[0])
        cut = told(_fit("gear-lf", Path(folder) / "cut", time_limit=1e-3)[0])
        again = told(_fit("gear-lf", Path(folder) / "cut", resume=True)[0])
    again["always"] |= {"as if never stopped": again == whole, "state when cut": cut["always"]["state"]}
    again["here"]["when cut"] = cut["here"]
    return again


# --- the command line ---------------------------------------------------------------------------------------


def command(*arguments):
    """Return the JSON that a command prints."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = CliRunner().invoke(app, [*map(str, arguments), "--json"], catch_exceptions=False)
    # 3: flagged, as a validation of a small fit is.
    assert done.exit_code in (0, 3), f"{arguments}: {done.output}"
    return json.loads(done.stdout)


def document(*arguments):
    """Return the JSON document of a command, by level."""
    found = steady(command(*arguments))
    return {"always": {"keys": keys_of(found), "verdicts": verdicts_of(found)}, "here": found}


def trust_of_gear():
    """Return the trust in a fit that is near its optimum, unlike the small ones."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "lf"
        _fit("gear-lf", out, population=32, max_generations=20, finish="cmaes")
        return document("trust", out, "--resamples", 4)


def landing_map():
    """Return all arrays of 4 x 4 maps of both surfaces, with motors off and reversed."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "map.h5"
        printed = command("landing-map", _HIGH, *_LANDED, "--out", out, *_GRID)
        arrays = {}

        def keep(name, item):
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
                arrays[name] = item[()]

        with h5py.File(out) as file:
            file.visititems(keep)
    for one in [printed, *printed["maps"]]:
        for key in ("file", "figure"):
            one.pop(key, None)
    return {
        "always": {name: [str(array.dtype), list(array.shape)] for name, array in arrays.items()},
        "cells": {name: bits(array) for name, array in arrays.items()},
        "here": {"hashes": {name: digest(array) for name, array in arrays.items()}, **steady(printed)},
    }


_HIGH = PUBLISHED / "published-gear-hf.json"
_LANDED = (PUBLISHED / "published-gear-lf.json", "--motor", PUBLISHED / "published-motor.json")
_GRID = ("--slopes", "4,14,24,40 deg", "--speeds", "0.3,0.7,1.1,1.5")
_DROP = SAMPLES / "gear-lf" / "drop-1-5deg-0.50mps.csv"


def json_keys():
    """Return the keys of what every cheap command prints with ``--json``."""
    lf, other, bench = own_copy("gear-lf"), own_copy("gear-lf"), own_copy("motor")
    small = (
        "--population", 8, "--runs", 1, "--max-generations", 1, "--finish", "none",
        "--no-check", "--no-trust",
    )  # fmt: skip
    bench_logs = [SAMPLES / "motor" / log for log in ("forward-1.csv", "reverse-1.h5", "static-forward.csv")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(lf, folder / "fits" / "lf")
        calls = {
            "formats": (),
            "inspect": (_DROP, *bench_logs),
            "convert": (_DROP, "--out", folder / "drop.h5"),
            "new-campaign": ("gear", "--out", folder / "new.toml"),
            "synthesize gear": ("--out", folder / "gear"),
            "synthesize motor": ("--out", folder / "motor"),
            "reversal-time": (SAMPLES / "motor" / "reversal-1.h5",),
            "fit-gear": (CAMPAIGNS["gear-lf"], *small, "--out", folder / "lf"),
            "fit-motor": (CAMPAIGNS["motor"], *small, "--out", folder / "mo"),
            "fits": (folder / "fits",),
            "show": (lf,),
            "export": (lf, "--out", folder / "sets.csv"),
            "compare": (lf, other),
            "trust": (bench,),
            "static-limits": _LANDED[:1],
            "simulate": (*_LANDED, "--slope", "10 deg", "--speed", 0.5),
            "landing-map": (*_LANDED, "--out", folder / "map.h5", *_GRID),
            "impulse-map": (
                *_LANDED, "--out", folder / "impulse.h5", "--slopes", "14,24 deg", "--speeds", "0.7,1.1",
                "--delays", "0:0.1:0.05", "--durations", "0:0.1:0.05",
            ),
            "design-study": (
                *_LANDED, "--out", folder / "study.h5", "--vary", "k_t=0.8:1.2:2", "--slopes", "10,20 deg",
                "--speeds", "0.6",
            ),
        }  # fmt: skip
        return {"always": {name: keys_of(command(*name.split(), *more)) for name, more in calls.items()}}


def slow_json_keys():
    """Return the keys of what the commands print that take some ten seconds each."""
    lf = own_copy("gear-lf")
    calls = {"report": (lf, "--out", lf / "golden.html"), "cross-validate": (lf,)}
    return {"always": {name: keys_of(command(name, *more)) for name, more in calls.items()}}


def commands():
    """Return the names of all commands, each with its arguments in order and its options by name."""

    def place(names):
        return names[0] if names[0].startswith("-") else ""

    def walk(one, name):
        below = getattr(one, "commands", {})
        own = {name: sorted(([*p.opts, *p.secondary_opts] for p in one.params), key=place)}
        for key, sub in below.items():
            own |= walk(sub, f"{name} {key}".strip())
        return own

    return {"always": walk(typer.main.get_command(app), "")}


# --- logs ---------------------------------------------------------------------------------------------------


def loaded(path, **options):
    """Return what a log loads to, by level; a refusal is the name of its error."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            log = load(path, **options)
        except SysidError as error:
            return {"always": type(error).__name__, "loaded": {}, "here": {}}
    out = {
        "always": {
            "kind": log.kind, "format": log.provenance.format, "device": log.provenance.device,
            "notes": len(log.provenance.notes), "warnings": len(heard), "channels": {},
        },
        "loaded": {},
        "here": {},
    }  # fmt: skip
    for name, one in log.channels.items():
        out["always"]["channels"][name] = [one.unit, digest(one.time)]
        if name.endswith("/orientation"):
            # Normalised and turned: sums of products, which some processors fuse.
            out["loaded"][name], out["here"][name] = moments(one.values), digest(one.values)
        else:
            out["always"]["channels"][name].append(digest(one.values))
    return out


def _by_level(found):
    levels = ("always", "loaded", "here")
    return {level: {name: one[level] for name, one in found.items()} for level in levels}


def sample_logs():
    """Return what the sample logs load to."""
    paths = sorted(path for path in SAMPLES.glob("*/*") if path.suffix in (".csv", ".h5"))
    return _by_level({path.relative_to(SAMPLES).as_posix(): loaded(path) for path in paths})


def public_logs():
    """Return what the public real logs load to, beside the project where they are there."""
    need = {f"xinlong_{one}.csv": {"length_unit": "m"} for one in ("20240811_01_18_04", "pose_0h5_1")}
    paths = sorted(path for path in PUBLIC_LOGS.rglob("*") if path.is_file())
    names = {path.relative_to(PUBLIC_LOGS).as_posix(): path for path in paths}
    return _by_level({name: loaded(path, **need.get(path.name, {})) for name, path in names.items()})


def made_logs():
    """Return what the logs of the property tests load to, whole and damaged in every way three times."""
    whole, damaged = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        for name, log in LOGS.items():
            path.write_bytes(log.data)
            whole[name] = loaded(path, **log.options)
            damaged[name] = {}
            for damage in DAMAGES:
                found = []
                for seed in range(3):
                    path.write_bytes(damage(log, np.random.default_rng(seed)))
                    one = loaded(path, **log.options)
                    text = json.dumps([one["always"], one["here"]], sort_keys=True)
                    short = hashlib.sha256(text.encode()).hexdigest()[:16]
                    found.append(one["always"] if isinstance(one["always"], str) else short)
                damaged[name][damage.__name__] = found
    out = _by_level(whole)
    return {**out, "here": {**out["here"], "damaged": damaged}}


def _of(subject, *arguments):
    return lambda: subject(*arguments)


SUBJECTS = {
    **{f"costs-{name}": _of(costs, name) for name in CAMPAIGNS},
    **{f"fit-{name}": _of(fit, name) for name in CAMPAIGNS},
    "fit-resumed": resumed_fit,
    "landing-map": landing_map,
    **{f"check-{name}": _of(document, "check", path) for name, path in CAMPAIGNS.items()},
    **{
        f"validate-{name}": lambda name=name: document("validate", own_copy(name), CAMPAIGNS[name])
        for name in CAMPAIGNS
    },
    "trust-motor": lambda: document("trust", own_copy("motor")),
    "trust-gear-lf": trust_of_gear,
    "sample-logs": sample_logs,
    "public-logs": public_logs,
    "made-logs": made_logs,
    "commands": commands,
    "json-keys": json_keys,
    "json-keys-slow": slow_json_keys,
}
SLOW = ("trust-gear-lf", "check-gear-hf", "json-keys-slow")
# Left out where this is not there.
NEEDS = {"public-logs": PUBLIC_LOGS}
