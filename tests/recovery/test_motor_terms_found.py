"""A motor with physics that the paper's model lacks: the fit says so, and the ladder finds and adopts it."""

import tomllib

import numpy as np
import pytest

from fakes.motor_bench import bench_of, problem_of
from sysid.fit.adequacy import adequacy
from sysid.motor.static_curves import NoLoadTie
from sysid.synthetic import synthesize_motor
from sysid.synthetic.motor import TRIALS
from sysid.trust.documents import ExplainDocument
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions

QUICK = {"runs": 1, "population": 24, "max_generations": 4, "quiet": True, "check": False, "trust": False}


@pytest.fixture(scope="module")
def sagging(tmp_path_factory):
    """A bench whose supply has 60 mΩ, and its fit."""
    out = tmp_path_factory.mktemp("sag") / "bench"
    synthesize_motor(out, seed=5, rate=2000.0, trials=TRIALS[:2], parameters={"supply_resistance": 0.06})
    path = out / "campaign.toml"
    return path, fit_campaign(path, FitOptions(out=out / "fit", **QUICK))


@pytest.mark.slow
def test_a_supply_that_sags_is_not_explained_and_then_found(sagging, tmp_path, run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    path, (result, folder) = sagging
    judged = result.provenance["adequacy"]
    assert judged["verdict"] == "not_explained"
    target = path.with_name("with-terms.toml")
    picture = tmp_path / "rungs.png"
    code, shown, err = run("explain", folder, "--adopt", target, "--figure", picture)
    assert (code, picture.is_file()) == (0, True), err
    document = ExplainDocument.read(folder)
    assert document.keep == ["supply sags"]
    kept = document.together[0].values
    # A bench of 6 s tells R and R_s to some percent.
    assert kept["supply_resistance"] == pytest.approx(0.06, rel=0.1)
    assert kept["winding_resistance"] == pytest.approx(0.299, rel=0.02)
    assert document.together[0].over_noise < 1.15
    # Parts of the two trials were left out; neither simpler model serves.
    assert len(document.trials) >= 10
    assert {rung.terms[0]: rung.kept for rung in document.simpler} == {
        "first-order lag": True, "without L": True,
    }  # fmt: skip
    assert "each part of a trial as" in " ".join(shown.split())
    assert "too simple" in shown
    assert "keep supply sags" in shown
    assert "supply_resistance" in tomllib.loads(target.read_text("utf-8"))["parameters"]["free"]
    campaign, bench = bench_of(target)
    problem = problem_of(campaign, bench).fitted
    row = problem.base.copy()
    for name, value in kept.items():
        row[problem.space.table.index[name]] = value
    assert adequacy(problem, problem.complete(row[None])[0]).verdict == "explained"


def test_the_no_load_line_of_loaded_points_knows_the_sag():
    # Loaded speeds of a motor with Ω_0 = 1030 u: Ω_0 = Ω + (R + R_s u²) c2 Ω²/k².
    u, k, drag, resistance, sag = np.array([0.3, 0.5, 0.7, 0.9]), 0.01, 1.6e-7, 0.25, 0.06
    gain = (resistance + sag * u**2) * drag / k**2
    speed = (np.sqrt(1 + 4 * gain * 1030 * u) - 1) / (2 * gain)
    tie = NoLoadTie(np.column_stack([u, np.ones_like(u)]), np.column_stack([speed, drag * speed**2]))
    line = tie.line(np.array([resistance / k**2]), np.zeros(1), np.array([sag / k**2]))
    np.testing.assert_allclose(line, [[1030.0, 0.0]], rtol=1e-9, atol=1e-6)
