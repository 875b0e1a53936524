"""Small motor campaigns on disk: written, edited and read by the tests of motor fits."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.campaign import read_campaign
from sysid.motor.known_values import motor_space, prepare_bench
from sysid.motor.log_delays import averaged
from sysid.motor.model import PARAMETERS, pack
from sysid.motor.problem import MotorProblem
from sysid.motor.simpler import simpler
from sysid.trust.ladder import starts_near
from sysid.trust.terms import downhill


def edited(path: Path, *pairs: tuple[str, str], name: str = "") -> Path:
    """Replace patterns, every one of which must occur, in a campaign or in a copy of that name beside it."""
    text = path.read_text(encoding="utf-8")
    for pattern, new in pairs:
        text, count = re.subn(pattern, new, text, flags=re.MULTILINE)
        assert count, pattern
    other = path.with_name(name or path.name)
    other.write_text(text, encoding="utf-8")
    return other


def with_trials(path: Path, keep, name: str, *pairs: tuple[str, str]) -> Path:
    """Write a copy with the `[[trials]]` tables that `keep` accepts, edited."""
    head, *trials = path.read_text(encoding="utf-8").split("[[trials]]")
    other = path.with_name(name)
    other.write_text("[[trials]]".join([head, *filter(keep, trials)]), encoding="utf-8")
    return edited(other, *pairs)


def bench_of(path: Path):
    """Return a campaign and its prepared bench."""
    campaign = read_campaign(path, "motor")
    return campaign, prepare_bench(campaign, path)


def table_of(path: Path) -> tuple[str, np.ndarray]:
    """Return the header of a CSV log and its numbers; NaN where a cell is blank."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    return lines[0], np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines[1:]])


def write_table(path: Path, header: str, table: np.ndarray) -> None:
    """Write a CSV log with nine digits."""
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g", encoding="utf-8")


def problem_of(campaign, bench, trials=None, **more) -> MotorProblem:
    """Return the problem of all trials of a bench, or of some, with what its campaign frees."""
    trials = bench.trials if trials is None else trials
    return MotorProblem.build(campaign, motor_space(campaign, bench), bench, trials, **more)


def score_values(campaign, bench, values) -> np.ndarray:
    """Return the NRMSE (T, 2) of values by name [SI] on every trial; what is left out the campaign states."""
    problem = problem_of(campaign, bench)
    left = {d: tie for d, tie in problem.ties.items() if f"no_load_slope_{d}" not in values}
    known = {name: value for name, value in problem.space.fixed.items() if name in PARAMETERS}
    row = pack({**bench.values, **known, **values})
    return replace(problem, ties=left).score(row[None]).by_channel[0]


def held_out(problem: MotorProblem, values) -> dict[str, np.ndarray]:
    """Return the NRMSE (2,) on the held-out runs, in one direction, of each simpler model and of the motor.

    Each is fitted to the fitted trials from around values by name [SI].
    """
    runs = tuple(
        t for t in problem.bench.trials if t.entry.use == "validate" and t.entry.direction != "reversal"
    )
    out = {}
    for title, model in [*simpler(problem.fitted), ("motor", problem.fitted)]:
        point, _ = downhill(model, starts_near(model.space, values))
        row = averaged(model.space, model.space.full(point[None]))
        out[title] = model.of(runs).score(row).by_channel[0].mean(axis=0)
    return out
