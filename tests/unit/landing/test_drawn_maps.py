"""Maps of draws: shares with their error, what decides a doubtful cell, the outcomes of single landings."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from fakes.landings import LF, MOTOR
from fakes.published import table_2
from sysid import landing_map, load_parameter_sets
from sysid.errors import ExportError
from sysid.landing.controllers import find_controller
from sysid.landing.drone import Motors, drones
from sysid.landing.maps import LandingMap
from sysid.landing.outcomes import LANDED, Outcome
from sysid.landing.settings import Scenario
from sysid.landing.simulate import land
from sysid.landing.store import read_maps, write_maps
from sysid.parameter_sets import DRAWS
from sysid.report.landing_figures import figure_of_file

DRAWN = 200
# Slopes [deg]: safe, on the edge, steeper ones on which some land, hopeless; touchdown speed [m/s].
SLOPES, SPEED = (20.0, 28.0, 34.0, 36.0, 42.0), 1.2


def drawn_gear(count=DRAWN, spread=0.1):
    """Sets of the published gear whose stiffness, friction and damping scatter."""
    sets, random = table_2("lf"), np.random.default_rng(5)
    values = np.repeat(sets.values[:1], count, axis=0)
    for name in ("leg_bending_stiffness", "leg_axial_damping", "kinetic_friction"):
        values[:, sets.column(name)] *= np.exp(spread * random.standard_normal(count))
    empty = np.full((count, *sets.nrmse_by_trial.shape[1:]), np.nan)
    return replace(
        sets, values=values, at_bound=np.zeros(values.shape, dtype=np.int8), nrmse=np.full(count, np.nan),
        nrmse_by_trial=empty, runs=(0,) * count, seeds=(0,) * count, provenance={DRAWS: count},
    )  # fmt: skip


def test_a_map_of_draws_says_what_single_landings_say():
    gear, controller = drawn_gear(), find_controller("reverse")
    found = landing_map(gear, MOTOR, slopes=SLOPES, speeds=[SPEED], controllers="reverse", check=False)
    (chart,) = found.content.maps
    share = chart.landed[:, 0]
    fleet = drones(gear, load_parameter_sets(MOTOR))
    # The draws weigh alike, so one history of the thrust serves all.
    motors = Motors(fleet[0])
    direct = np.empty(len(SLOPES))
    for s, slope in enumerate(SLOPES):
        begin = Scenario(float(np.radians(slope)), SPEED)
        alone = [land(drone, begin, controller, rate=100.0, motors=motors).outcome for drone in fleet]
        direct[s] = np.mean([outcome in LANDED for outcome in alone])
    # A landing on the border of two classes may change with the path of the integrator: one in a hundred.
    np.testing.assert_allclose(share, direct, atol=0.01)
    np.testing.assert_allclose(
        chart.error(share[:, None])[:, 0], np.sqrt(share * (1 - share) / DRAWN), atol=1e-9
    )
    assert share[0] == 1.0
    assert share[-1] < 0.05
    assert np.count_nonzero((share > 0.05) & (share < 0.95)) >= 2


def made_map(numbers, landed):
    """A map of one slope; `landed` (S, m) says which draw lands in which cell."""
    shape = (len(landed), 1, landed.shape[1])
    outcome = np.where(landed, Outcome.NEAR, Outcome.FLIPPED).astype(np.int8).reshape(shape)
    known = np.where(outcome == Outcome.NEAR, 0.5, np.nan)
    names = tuple(f"draw {number}" for number in range(1, len(landed) + 1))
    axes = np.array([20.0]), np.arange(1.0, 1.0 + landed.shape[1])
    return LandingMap("lf", "off", names, *axes, outcome, known, known, outcome == 9, numbers=numbers)


def test_the_parameter_that_decides_a_doubtful_cell_is_named():
    random = np.random.default_rng(7)
    numbers = {name: random.random(100) for name in ("friction", "stiffness", "mass")}
    landed = np.column_stack([
        numbers["friction"] > 0.4,  # friction decides
        numbers["stiffness"] < 0.3,  # low stiffness lands
        random.random(100) > 0.5,  # chance
        np.full(100, True),  # no doubt
    ])  # fmt: skip
    names, rho = made_map(numbers, landed).deciding()
    assert names[0].tolist() == ["friction", "stiffness", "", ""]
    # The rank correlation of a step at 0.4 with uniform numbers: sqrt(3 × 0.4 × 0.6) = 0.85.
    assert rho[0, 0] == pytest.approx(0.85, abs=0.03)
    assert rho[0, 1] < -0.7
    assert np.isnan(rho[0, 2:]).all()
    # Runs of one optimum are no sample.
    assert made_map({}, landed).deciding()[0].tolist() == [["", "", "", ""]]


def test_what_lands_is_95_percent_of_draws_and_half_of_runs():
    landed = np.arange(100)[:, None] < np.array([[96, 94, 51]])
    drawn, runs = made_map({"mass": np.arange(100.0)}, landed), made_map({}, landed)
    assert [drawn.steepest(speed) for speed in drawn.speeds.tolist()] == pytest.approx(
        [20, np.nan, np.nan], nan_ok=True
    )
    assert [runs.steepest(speed) for speed in runs.speeds.tolist()] == [20.0, 20.0, 20.0]
    assert drawn.summary()["quorum"] == "95 % of the draws"
    assert runs.summary()["quorum"] == "half of the sets"


def test_the_file_keeps_shares_errors_and_draws(tmp_path):
    found = landing_map(
        drawn_gear(30), MOTOR, slopes="10:30:10deg", speeds=[0.5, 1.0], controllers="reverse", check=False
    )
    path = write_maps(tmp_path / "map.h5", found.content)
    (before,), (after,) = found.content.maps, read_maps(path).maps
    assert set(after.numbers) == {"leg_bending_stiffness", "leg_axial_damping", "kinetic_friction"}
    for name, values in before.numbers.items():
        np.testing.assert_array_equal(after.numbers[name], values)
    assert after.sets[0] == "published-gear-lf draw 1"
    with h5py.File(path) as file:
        share, error = file["maps/1/probability"][()], file["maps/1/probability_error"][()]
        assert file["maps/1/decided_by"].shape == file["maps/1/decided_by_correlation"].shape == (3, 2)
    np.testing.assert_allclose(error, np.sqrt(share * (1 - share) / 30), rtol=1e-12)
    titles = figure_of_file(found.content).legends[0]
    assert "draws" in titles.get_title().get_text()


def test_draws_need_intervals(run, tmp_path):
    code, _, err = run("landing-map", LF, "--motor", MOTOR, "--draws", "5", "--out", tmp_path / "map.h5")
    assert code == 2
    assert "--draws 5 needs the folder of a fit" in err
    assert not list(tmp_path.iterdir())
    code, _, err = run("simulate", LF, "--motor", MOTOR, "--slope", "20deg", "--speed", "0.5", "--draws", "0")
    assert code == 2
    assert "--draws" in err


def test_drawn_motors_are_paired_with_drawn_gears():
    motor = load_parameter_sets(MOTOR)
    two = replace(
        motor, values=motor.values * np.array([[1.0], [1.01]]), nrmse=np.full(2, np.nan),
        at_bound=np.repeat(motor.at_bound, 2, axis=0), runs=(0, 0), seeds=(0, 0),
        nrmse_by_trial=np.repeat(motor.nrmse_by_trial, 2, axis=0), provenance={DRAWS: 2},
    )  # fmt: skip
    first, second = drones(drawn_gear(2), two)
    assert second.motor["winding_resistance"] == pytest.approx(1.01 * first.motor["winding_resistance"])
    with pytest.raises(ExportError, match="2 motor sets for 3 gear sets"):
        drones(drawn_gear(3), two)
