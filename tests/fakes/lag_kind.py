"""A third model, a first-order lag that is fitted to steps: all that a kind needs, and a campaign of it."""

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from sysid.campaign import FitTable
from sysid.campaign.common import CampaignTable, TomlTable, TrialTable
from sysid.fit.kind import Kind, Term
from sysid.fit.nrmse import CostChannel, FilteredNrmse, TrialTarget
from sysid.fit.problem import Problem
from sysid.fit.trial import Prediction, Trial
from sysid.parameters import Parameter, ParameterTable
from sysid.workflows.kinds import register

TABLE = ParameterTable(
    [
        Parameter("gain", "K", "rad/s", 1.0, 0.1, 10.0, "log", "Speed per unit step.", "guess"),
        Parameter("time_constant", "τ", "s", 0.2, 0.01, 2.0, "log", "Time to 63 %.", "guess"),
        Parameter("offset", "y_0", "rad/s", 0.0, -1.0, 1.0, "linear", "Speed at rest.", "guess"),
    ]
)


class LagCost(TomlTable):
    denominator: Literal["std", "range"] = "std"


class LagTrial(TrialTable):
    step: float


class LagCampaign(CampaignTable):
    kind: Literal["lag"]
    cost: LagCost = LagCost()
    fit: FitTable = FitTable()
    trials: tuple[LagTrial, ...]


@dataclass(frozen=True, eq=False)
class LagProblem(Problem):
    campaign: LagCampaign
    space: object
    logs_read: tuple
    threads: int | None = None

    @cached_property
    def trials(self):
        return tuple(
            Trial(entry.name, entry.use, t, y[:, None], np.ones((t.size, 1), bool), record, 0.0)
            for entry, t, y, record in self.logs_read
        )

    @cached_property
    def cost(self):
        targets = [TrialTarget(trial.name, trial.measured) for trial in self.trials]
        return FilteredNrmse(targets, [CostChannel("speed", "rad/s", 0)], self.campaign.cost.denominator)

    @property
    def noise(self):
        return np.full((len(self.trials), 1), NOISE)

    def only(self, names):
        return replace(self, logs_read=tuple(log for log in self.logs_read if log[0].name in names))

    def predict(self, rows):
        gain, tau, offset = (rows[:, i, None] for i in range(3))
        out = [offset + gain * log[0].step * (1 - np.exp(-log[1] / tau)) for log in self.logs_read]
        signals = tuple(y[:, :, None] for y in out)
        by_channel, failed = self.cost(np.concatenate(signals, axis=1), threads=self.threads)
        return Prediction(by_channel, failed.astype(np.int8), signals)


def open_lag(campaign, path, threads):
    logs = []
    for entry in campaign.trials:
        text = (Path(path).parent / entry.log).read_bytes()
        time, speed = np.array(json.loads(text))
        record = {"log": entry.log, "sha256": hashlib.sha256(text).hexdigest()}
        logs.append((entry, time, speed, record))
    space = campaign.parameters.search_space(TABLE, ("gain", "time_constant"), {})
    return LagProblem(campaign, space, tuple(logs), threads)


TRUE = {"gain": 3.0, "time_constant": 0.15}
SIGMA = 0.02
# What the kind says of the noise [rad/s]; NaN: nothing.
NOISE = SIGMA
SEARCH = "runs = 2\npopulation = 24\nmax_generations = 40\n"


def write_lag(folder, search=SEARCH, names=("step-0", "step-1", "step-2", "step-3"), offset=0.0):
    """Write a campaign of steps, all but the last to fit, and return its file; the kind is registered."""
    terms = (Term("speed at rest", ("offset",)),)
    register(Kind("lag", LagCampaign, open_lag, terms=terms))
    source = np.random.default_rng(3)
    text = f'name = "bench"\nkind = "lag"\n[fit]\n{search}'
    for k, name in enumerate(names):
        step = 0.5 + 0.5 * k
        time = np.arange(200) * 0.005
        speed = offset + TRUE["gain"] * step * (1 - np.exp(-time / TRUE["time_constant"]))
        speed += SIGMA * source.standard_normal(time.size)
        (folder / f"{k}.json").write_text(json.dumps([time.tolist(), speed.tolist()]), encoding="utf-8")
        use = "fit" if k < len(names) - 1 else "validate"
        # JSON's text in quotes is TOML's too.
        text += f'[[trials]]\nname = {json.dumps(name)}\nlog = "{k}.json"\nuse = "{use}"\nstep = {step}\n'
    path = folder / "lag.toml"
    path.write_text(text, encoding="utf-8")
    return path
