"""The order in which a campaign names its trials changes no bit of what is found."""

import re
import shutil

import numpy as np
import pytest

from fakes.lag_kind import write_lag
from fakes.places import SAMPLES
from sysid.fit.trial import name_order
from sysid.trust.documents import TrustDocument
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions

SMALL = {"population": 16, "runs": 1, "max_generations": 3, "quiet": True, "check": False, "trust": False}


@pytest.mark.parametrize("name", ["gear-lf", "motor"])
def test_the_order_of_trials_changes_no_bit(name, tmp_path):
    """Each drop has a slope of its own that the fit moves, each motor log a delay."""
    folder = shutil.copytree(SAMPLES / name, tmp_path / name)
    head, *trials = re.split(r"(?m)^(?=\[\[trials\]\])", (folder / "campaign.toml").read_text("utf-8"))
    # Of the drops three are enough for an order.
    trials = [trial.rstrip() + "\n\n" for trial in (trials[:3] if name == "gear-lf" else trials)]
    fits = []
    for order in (1, -1):
        path = folder / f"{order}.toml"
        path.write_text("".join([head, *trials[::order]]), encoding="utf-8")
        fits.append(fit_campaign(path, FitOptions(out=tmp_path / f"fit{order}", **SMALL))[0])
    one, other = fits
    # Results are in the campaign's order.
    assert [trial.name for trial in other.trials] == [trial.name for trial in one.trials][::-1]
    for stage, same in zip(one.runs[0].stages, other.runs[0].stages, strict=True):
        np.testing.assert_array_equal(stage.cube, same.cube)
        np.testing.assert_array_equal(stage.cost, same.cost)
    named = [dict(zip([p.name for p in fit.parameters], fit.values.T, strict=True)) for fit in fits]
    assert named[0].keys() == named[1].keys()
    for parameter, values in named[0].items():
        np.testing.assert_array_equal(values, named[1][parameter], err_msg=parameter)
    np.testing.assert_array_equal(one.nrmse, other.nrmse)
    by_trial = [{trial.name: trial.nrmse.tolist() for trial in fit.trials} for fit in fits]
    assert by_trial[0] == by_trial[1]


def test_the_order_of_trials_changes_no_bit_of_an_interval(tmp_path):
    path, intervals = write_lag(tmp_path, "runs = 1\npopulation = 8\nmax_generations = 2\n"), []
    head, *trials = re.split(r"(?m)^(?=\[\[trials\]\])", path.read_text(encoding="utf-8"))
    for order in (1, -1):
        path.write_text("".join([head, *trials[::order]]), encoding="utf-8")
        out = fit_campaign(path, FitOptions(out=tmp_path / f"fit{order}", **{**SMALL, "trust": True}))[1]
        rows = TrustDocument.read(out).parameters
        intervals.append([(row.name, row.refined, row.interval_95, row.interval_68) for row in rows])
    assert len(intervals[0]) == 2
    assert intervals[0] == intervals[1]


def test_drops_are_sorted_as_people_count():
    names = ["drop-10", "drop-2", "a1", "a01", "drop-1"]
    assert sorted(names, key=name_order) == ["a01", "a1", "drop-1", "drop-2", "drop-10"]
