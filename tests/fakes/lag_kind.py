"""A third model, a first-order lag that is fitted to steps, and a campaign of it."""

import json

import numpy as np
import pandas as pd

import sysid

TRUE = {"gain": 3.0, "time_constant": 0.15}
SIGMA = 0.02
SEARCH = "runs = 2\npopulation = 24\nmax_generations = 40\n"


def respond(values, time, trial):
    rise = values["gain"] * trial["step"] * (1 - np.exp(-time / values["time_constant"]))
    return values["offset"] + rise


sysid.model(
    "lag", respond, vectorized=True, channels={"speed": "rad/s"}, inputs={"step": "1"},
    parameters={
        "gain": (0.1, 10.0, "rad/s"), "time_constant": (0.01, 2.0, "s"),
        "offset": (-1.0, 1.0, "rad/s", "term"),
    },
)  # fmt: skip


def write_lag(
    folder, search=SEARCH, names=("step-0", "step-1", "step-2", "step-3"), offset=0.0, noise=SIGMA
):  # fmt: skip
    """Write a campaign of steps, all but the last to fit, and return its file."""
    source = np.random.default_rng(3)
    text = f'name = "bench"\nkind = "lag"\nnoise = {{ speed = "{noise} rad/s" }}\n[fit]\n{search}'
    for k, name in enumerate(names):
        step = 0.5 + 0.5 * k
        time = np.arange(200) * 0.005
        speed = respond({**TRUE, "offset": offset}, time, {"step": step})
        speed += SIGMA * source.standard_normal(time.size)
        table = pd.DataFrame({"time [s]": time, "speed [rad/s]": speed})
        table.to_csv(folder / f"{k}.csv", index=False)
        use = "fit" if k < len(names) - 1 else "validate"
        # JSON's text in quotes is TOML's too.
        text += f'[[trials]]\nname = {json.dumps(name)}\nlog = "{k}.csv"\nuse = "{use}"\nstep = {step}\n'
    path = folder / "lag.toml"
    path.write_text(text, encoding="utf-8")
    return path
