"""A user's script that uses every public name of sysid; `mypy --strict` reads it, nothing runs it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

import sysid
from sysid.testing import check_kind


def simulate(
    values: Mapping[str, float], time: npt.NDArray[np.float64], trial: Mapping[str, Any]
) -> npt.NDArray[np.float64]:
    return values["start"] * np.exp(-values["rate"] * time)


def fitted(campaign: sysid.Campaign) -> sysid.Fit:
    checked: sysid.Judgement[Any] = campaign.check(threads=1)
    rows: pd.DataFrame = checked.table
    print(sysid.__version__, campaign.kind, len(rows), checked.sentences)
    fit = sysid.fit_campaign(campaign, "fits/decay", runs=2, time_limit="1 min", progress=print)
    trusted: pd.DataFrame = fit.trust(resamples=10).to_frame()
    page: Path = fit.report(force=True)
    print(trusted, page, fit.verdict, fit.trial("a").to_frame(), fit.trials)
    return fit


def main() -> int:
    decay: sysid.Model = sysid.model(
        "decay", simulate, channels={"level": "V"},
        parameters={"rate": (0.1, 10, "1/s"), "start": (0.1, 5, "V", "each trial")},
    )  # fmt: skip
    tables: dict[str, pd.DataFrame | Path] = {
        "a": pd.DataFrame({"level": [1.0, 0.5]}, index=[0.0, 0.1]), "b": Path("b.csv"),
    }  # fmt: skip
    campaign: sysid.Campaign = decay.campaign(tables, noise={"level": "10 mV"}, validate=["b"])
    check_kind(campaign)
    fit = fitted(campaign)
    for judged in (sysid.validate(fit, campaign), sysid.cross_validate(fit), sysid.explain(fit)):
        print(judged.table, judged.warnings)
    other: sysid.Fit = sysid.load_fit("fits/other")
    differences: list[str] = [row.parameter for row in sysid.compare(fit, other).document.differences]
    gear, motor = sysid.fit_gear("bench/gear", surface="hf"), sysid.fit_motor(Path("bench/motor"))
    sets: sysid.ParameterSets = sysid.load_parameter_sets("gear.json")
    stiffness: npt.NDArray[np.float64] = sets["k_h"]
    written: list[Path] = sets.save("sets.csv", force=True)
    best: float = sets.best["leg_axial_stiffness"]
    print(differences, stiffness.mean(), written, best)
    drop = sysid.simulate_drop(sets, slope="20 deg", speed=0.5)
    landing = sysid.simulate_landing(gear, motor, "20 deg", "0.5 m/s", controller="reverse")
    motion: pd.DataFrame = drop.to_frame()
    print(motion, landing.outcome.name, landing.events)
    maps = sysid.landing_map([gear], motor, slopes="0:10:5 deg", speeds=[0.2, 0.4])
    impulses = sysid.impulse_map(sets, motor, threads=1)
    study = sysid.design_study(gear, motor, "leg_length")
    limits: pd.DataFrame = sysid.static_limits(sets, thrust=[0, 12])
    print(maps.to_frame(), impulses.to_frame(), study.to_frame(), limits)
    numbers: pd.DataFrame = sysid.numbers_for(motor.sets, "gazebo", mass=1.2).to_frame()
    log = sysid.load_log("log.csv", rate="1 kHz")
    report = sysid.inspect("log.csv")
    print(numbers, log["speed"].values.mean(), report)
    try:
        sysid.load_fit("none")
    except sysid.SysidError as error:
        return len(str(error))
    return 0
