"""A model that lacks something, from the end of its fit to its exports: what is said of it, and how often."""

from types import SimpleNamespace

import pytest

from fakes.lag_kind import write_lag
from sysid.fit import problem
from sysid.trust import influence
from sysid.workflows import fit as walk
from sysid.workflows.options import FitOptions
from sysid.workflows.show import print_fit


@pytest.fixture
def fit(tmp_path, capsys):
    """Fit steps from a speed that the lag does not know; a bound cuts the time constant that makes up.

    What is noticed as it comes (`heard`) and what is printed at the end (`printed`) are lines.
    """

    def call(**options):
        path = write_lag(tmp_path, offset=-0.8)
        bounds = '[parameters.bounds]\ntime_constant = ["0.01 s", "0.12 s"]\n'
        path.write_text(path.read_text(encoding="utf-8") + bounds, encoding="utf-8")
        heard = []
        options = FitOptions(out=tmp_path / "fit", quiet=True, **options)
        result, folder = walk.fit_campaign(path, options, say=heard.append)
        capsys.readouterr()
        print_fit(result, folder, False)
        printed = capsys.readouterr().out.splitlines()
        return SimpleNamespace(result=result, folder=folder, heard=heard, printed=printed)

    return call


def test_no_trial_is_to_be_dropped_before_the_terms_were_tried(fit, monkeypatch):
    monkeypatch.setattr(influence, "HANGS", 0.0)
    lines = [line for line in fit().heard if "bends every parameter" in line or "hangs on" in line]
    assert len(lines) >= 2
    for line in lines:
        assert line.endswith("; a term that the model lacks does that: try sysid ladder first")
        assert "validate" not in line


@pytest.mark.parametrize(
    ("noise", "trust", "ranges"), [(1.0, False, True), (1.0, True, False), (0.02, False, False)]
)
def test_a_spread_of_the_sets_is_stated_where_no_interval_is_and_noise_explains(
    fit, monkeypatch, noise, trust, ranges
):
    monkeypatch.setattr(problem, "ASSUMED_NOISE", noise)
    asked = []
    monkeypatch.setattr(walk, "loose_findings", lambda *given: asked.append(given[-1]) or ())
    fit(trust=trust)
    assert asked == [ranges]
