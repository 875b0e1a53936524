"""Campaigns on which the search is chosen: truths, noise, gaps, bad drops, wrong models, motor sizes."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from fakes.foreign_gear import drawn_terms, simulator
from sysid.gear import model
from sysid.synthetic import DropPlan, synthesize_gear, synthesize_motor
from sysid.synthetic.motor import TRUE_MOTOR
from sysid.workflows.kinds import open_campaign

_SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"
# Of every true parameter, up or down, and of drawn drops: steepest slope [deg], fastest impact [m/s].
_SPREAD = 0.2
_DROPS = {"lf": (30.0, 0.85), "hf": (26.0, 0.7)}


def _truth(surface, seed, front=False):
    """Return drawn true values; with `front`, legs that differ from the rear ones, which no fit frees."""
    source = np.random.default_rng(seed)
    rows = model.parameters_on(surface)
    true = {
        name: rows[name].nominal * math.exp(_SPREAD * source.uniform(-1, 1))
        for name in model.SURFACES[surface].free
        if rows[name].nominal != 0
    }
    if front:
        ratios = (name for name in rows if name.startswith("front_"))
        true |= {name: 1.15 if "stiffness" in name else 0.8 for name in ratios}
    return true


def _drops(surface, seed, count):
    source = np.random.default_rng(seed)
    steepest, fastest = _DROPS[surface]
    pairs = ((source.uniform(4, steepest), source.uniform(0.4, fastest)) for _ in range(count))
    return [DropPlan(math.radians(round(slope, 1)), round(speed, 2)) for slope, speed in pairs]


def _gear(folder, surface, seed, *, drops=None, front=False, drawn=True, **lab):
    plans = None if drops is None else _drops(surface, seed + 77, drops)
    true = _truth(surface, seed, front) if drawn else None
    return synthesize_gear(folder, seed=seed, surface=surface, drops=plans, parameters=true, **lab)


def _bad_drop(folder, surface):
    """One drop whose slope is written down 1.5 degrees too steep."""
    out = _gear(folder, surface, 32, drawn=False) / "campaign.toml"
    text = out.read_text(encoding="utf-8")
    out.write_text(text.replace('slope = "15 deg"', 'slope = "16.5 deg"'), encoding="utf-8")
    return out.parent


def _foreign(folder, seed):
    """Drops of a gear with three terms that the model lacks."""
    return synthesize_gear(folder, seed=seed, surface="lf", simulate=simulator(**drawn_terms(seed, 3)))


def _motor(folder, seed, size):
    scaled = {
        "rotor_inertia": size, "winding_resistance": size**-0.5, "winding_inductance": size**0.5,
        "thrust_quadratic_forward": size, "thrust_quadratic_reverse": size,
        "torque_quadratic_forward": size, "torque_quadratic_reverse": size,
    }  # fmt: skip
    true = {name: TRUE_MOTOR[name] * factor for name, factor in scaled.items()}
    return synthesize_motor(folder, seed=seed, parameters=true)


# Name: what it is, and (folder) -> campaign folder.
CAMPAIGNS = {
    "motor": ("sample logs", lambda _: _SAMPLES / "motor"),
    "motor-small": ("half the rotor", lambda folder: _motor(folder, 3, 0.5)),
    "motor-large": ("twice the rotor", lambda folder: _motor(folder, 4, 2.0)),
}
for _seed in (101, 103, 104):
    CAMPAIGNS[f"lf-foreign-{_seed}"] = ("three foreign terms", lambda f, seed=_seed: _foreign(f, seed))
for _law in ("lf", "hf"):
    CAMPAIGNS |= {
        f"{_law}": ("six sample-like drops", lambda f, s=_law: _gear(f, s, 1, drawn=False)),
        f"{_law}-slow": ("150 Hz, 0.1 mm, five drawn drops", lambda f, s=_law: _gear(
            f, s, 11, drops=5, rate=150.0, noise_position=1e-4)),
        f"{_law}-fast": ("360 Hz, 0.5 mm, six drawn drops", lambda f, s=_law: _gear(
            f, s, 12, drops=6, rate=360.0, noise_position=5e-4)),
        f"{_law}-drawn": ("six drawn drops", lambda f, s=_law: _gear(f, s, 13, drops=6)),
        f"{_law}-few": ("three drawn drops", lambda f, s=_law: _gear(f, s, 21, drops=3)),
        f"{_law}-many": ("twenty drawn drops", lambda f, s=_law: _gear(f, s, 22, drops=20)),
        f"{_law}-gap": ("0.1 s of one drop lost", lambda f, s=_law: _gear(f, s, 33)),
        f"{_law}-bad": ("one slope off by 1.5 deg", lambda f, s=_law: _bad_drop(f, s)),
        f"{_law}-wrong": ("front legs differ", lambda f, s=_law: _gear(f, s, 31, front=True)),
    }  # fmt: skip


def problem(name, folder, threads=None):
    """Return the fit problem of a campaign, which is written into a folder."""
    source = CAMPAIGNS[name][1](folder / name)
    path = source / "campaign.toml"
    kind, campaign, _ = open_campaign(path, None, {})
    fitted = kind.open(campaign, path, threads).fitted
    if name.endswith("-gap"):
        drops = list(fitted.drops)
        target = drops[1].target
        valid = np.ones(len(target.measured), bool) if target.valid is None else np.array(target.valid)
        valid[20:40] = False
        drops[1] = replace(drops[1], target=replace(target, valid=valid))
        fitted = replace(fitted, drops=tuple(drops))
    return fitted
