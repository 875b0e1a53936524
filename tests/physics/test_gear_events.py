"""Events of a drop: located, logged, and the limits of sliding and tipping that follow from the laws."""

import math

import numpy as np
import pytest
from numba import njit
from typer.testing import CliRunner

from fakes.gear_drops import foot_depths, level_start
from sysid.cli import app
from sysid.fit.store import read_fit
from sysid.gear.model import (
    PARAMETERS,
    SURFACES,
    TIGHT_TOLERANCE,
    EventKind,
    Surface,
    find_surface,
    parameters_on,
    simulate,
)
from sysid.gear.surfaces import continuous_law
from sysid.report.gear_report import GearReport
from sysid.synthetic import synthesize_gear
from sysid.synthetic.gear import LF_DROPS


@pytest.mark.parametrize("surface", ["lf", "hf"])
@pytest.mark.parametrize("slope_deg", [10, 27])
def test_events_are_located_to_a_microsecond(surface, slope_deg):
    p, slope = parameters_on(surface).nominal, math.radians(slope_deg)
    body = level_start(slope, 0.7)
    clock = np.array([0.0, 0.16])
    ours = simulate(p, slope, body, clock, surface=surface, tolerance=TIGHT_TOLERANCE)
    exact = simulate(p, slope, body, clock, surface=surface, tolerance=1e-9)
    assert len(ours.events) >= 4
    assert [(e.kind, e.foot) for e in ours.events] == [(e.kind, e.foot) for e in exact.events]
    for event, twin in zip(ours.events, exact.events, strict=True):
        assert event.time == pytest.approx(twin.time, abs=1e-6), event
    contacts = [e for e in exact.events if e.kind in (EventKind.TOUCHDOWN, EventKind.LIFT_OFF)]
    times = np.array([e.time for e in contacts])
    at = simulate(p, slope, body, np.concatenate([[0.0], times, [0.16]]), surface=surface, tolerance=1e-9)
    depth = foot_depths(p, slope, at.state[1:-1])
    for e, row in zip(contacts, depth, strict=True):
        # At the event the foot is at the surface: 1e-6 s at 1 m/s is 1 um.
        assert abs(row[("rear", "front").index(e.foot)]) < 1e-6


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_touchdown_and_lift_off_alternate(surface):
    p, slope = parameters_on(surface).nominal, math.radians(15)
    time = np.arange(0, 0.7, 1e-4)
    run = simulate(p, slope, level_start(slope, 0.8), time, surface=surface, tolerance=1e-6)
    assert [e.time for e in run.events] == sorted(e.time for e in run.events)
    for number, foot in enumerate(("rear", "front")):
        kinds = [e for e in run.events if e.foot == foot and e.kind <= EventKind.LIFT_OFF]
        assert all(e.kind == i % 2 for i, e in enumerate(kinds))
        touching = np.zeros(len(time), dtype=bool)
        for e in kinds:
            touching[time >= e.time] = e.kind == EventKind.TOUCHDOWN
        # The log says of every sample whether the foot is loaded, but for samples at the event itself.
        assert np.mean(touching != (run.normal_force[:, number] > 0)) < 1e-3
    modes = [e for e in run.events if e.kind in (EventKind.SLIP, EventKind.STICK)]
    assert len(modes) == len(run.switches)
    assert bool(modes) == (surface == "hf")


def test_flip_and_rest():
    p = parameters_on("hf").nominal
    slope = math.radians(40)
    run = simulate(p, slope, level_start(slope, 1.2), np.arange(0, 2, 1e-3), surface="hf")
    (flip,) = [e for e in run.events if e.kind is EventKind.FLIP]
    turn = np.abs(run.state[:, 2] - slope)
    assert flip.foot == "body"
    assert flip.time == pytest.approx(run.time[np.argmax(turn > math.radians(80))], abs=1e-3)
    slope = math.radians(5)
    run = simulate(p, slope, level_start(slope, 0.2), np.arange(0, 3, 1e-3), surface="hf")
    (rest,) = [e for e in run.events if e.kind is EventKind.REST]
    calm = (np.hypot(run.state[:, 7], run.state[:, 8]) < 0.05) & (np.abs(run.state[:, 9]) < 0.2)
    begin = int(np.ceil(rest.time / 1e-3))
    assert calm[begin : begin + 200].all()
    assert not calm[begin - 2]
    # Nothing before it lasted 0.2 s.
    runs = np.diff(np.flatnonzero(~calm[: begin + 1]))
    assert runs.max() < 201


@pytest.mark.parametrize(
    ("kind", "slope_deg", "speed", "horizon"), [(EventKind.FLIP, 40, 1.2, 2.0), (EventKind.REST, 5, 0.2, 3.0)]
)
def test_flip_and_rest_are_located_to_a_microsecond(kind, slope_deg, speed, horizon):
    p, slope = parameters_on("hf").nominal, math.radians(slope_deg)
    body = level_start(slope, speed)
    clock = np.array([0.0, horizon])
    (event,) = [e for e in simulate(p, slope, body, clock, surface="hf").events if e.kind is kind]
    around = np.array([0.0, event.time - 1e-6, event.time + 1e-6, horizon])
    # The same steps, sampled beside the event: what defines it changes sign within 1 us on either side.
    state = simulate(p, slope, body, around, surface="hf").state
    turn = np.abs(state[:, 2] - slope) - math.radians(80)
    motion = np.maximum(np.hypot(state[:, 7], state[:, 8]) / 0.05, np.abs(state[:, 9]) / 0.2) - 1
    before, after = (turn if kind is EventKind.FLIP else -motion)[1:3]
    assert before < 0 < after


def test_slide_limit_is_the_friction_angle():
    p = PARAMETERS.nominal
    limit = math.degrees(math.atan(p["kinetic_friction"]))
    assert limit == pytest.approx(23.7, abs=0.1)
    gained = []
    for slope_deg in (limit - 0.5, limit + 0.5):
        slope = math.radians(slope_deg)
        run = simulate(p, slope, level_start(slope, 0.05, 1e-4), np.linspace(0, 80, 81))
        along = run.state[:, 7] * math.cos(slope) - run.state[:, 8] * math.sin(slope)
        gained.append(along[-1] - along[40])
    # Over 40 s: below it a terminal speed (which the ringing legs let waver by 0.1 m/s); above it the steady
    # acceleration g (sin q - mu_k cos q) = 0.09 m/s^2.
    assert gained[0] < 0.2
    assert gained[1] > 3.0


def test_tip_limit_of_rigid_legs():
    p = parameters_on("hf").nominal
    stiff = p | {"kinetic_friction": 1.2}
    for way in ("axial", "bending"):
        stiff[f"leg_{way}_stiffness"] *= 1e3
        stiff[f"leg_{way}_damping"] *= 30
    limit = math.degrees(math.atan(p["foot_dx"] / p["foot_dz"]))
    assert limit == pytest.approx(34.8, abs=0.1)
    turned = []
    for slope_deg in (limit - 0.5, limit + 0.5):
        slope = math.radians(slope_deg)
        weight = (p["body_mass"] + 2 * p["leg_mass"]) * p["gravity"]
        tip = math.tan(slope) * p["foot_dz"] / p["foot_dx"]
        # The end of a slow ramp: at rest on the slope, feet sunk by their share of the weight.
        rear, front = (max(0.0, weight / 2 * math.cos(slope) * (1 + s * tip)) for s in (-1, 1))
        sink = np.array([rear, front]) / p["ground_stiffness"]
        pitch = slope + (sink[1] - sink[0]) / (2 * p["foot_dx"])
        height = p["foot_dz"] - sink.mean()
        body = [height * math.sin(slope), height * math.cos(slope), pitch, 0.0, 0.0, 0.0]
        run = simulate(stiff, slope, body, np.linspace(0, 2.5, 6), surface="hf")
        assert np.isfinite(run.state).all()
        turned.append(math.degrees(abs(run.state[-1, 2] - slope)))
    assert turned[0] < 1.0
    assert turned[1] > 45.0


@njit(error_model="numpy", forceinline=True)
def viscous(force_c, force_d, slip_c, slip_d, law):
    """F_t = -c F_n v with c in the place of the kinetic friction [s/m]."""
    return -law[0] * force_c * slip_c, -law[0] * force_d * slip_d


@njit(error_model="numpy", forceinline=True)
def viscous_damping(force, slip, law):
    return law[0] * force


@pytest.mark.slow  # compiles another law
def test_a_third_law_is_one_declaration(monkeypatch, tmp_path):
    wet = Surface(
        name="wet",
        reads=("kinetic_friction",),
        free=SURFACES["lf"].free,
        solve=continuous_law(viscous, viscous_damping),
        friction=viscous,
    )
    p, slope = PARAMETERS.nominal | {"kinetic_friction": 1.0}, math.radians(10)
    run = simulate(p, slope, level_start(slope, 0.1), np.linspace(0, 4, 41), surface=wet)
    along = run.state[:, 7] * math.cos(slope) - run.state[:, 8] * math.sin(slope)
    # Terminal speed tan(slope)/c.
    assert along[-1] == pytest.approx(math.tan(slope), rel=0.02)
    np.testing.assert_allclose(run.friction_force[-1], -run.normal_force[-1] * along[-1], rtol=0.05)
    # In the table, where its file puts it, it can be named wherever a law is.
    monkeypatch.setitem(SURFACES, "wet", wet)
    folder = synthesize_gear(tmp_path / "drops", seed=1, surface="wet", drops=LF_DROPS[:2])
    campaign = folder / "campaign.toml"
    assert 'law = "wet"' in campaign.read_text(encoding="utf-8")
    fit = ["fit-gear", campaign, "--out", tmp_path / "fit", "--population", 16, "--runs", 1, "--no-trust"]
    fit += ["--max-generations", 2, "--finish", "none", "--surface", "wet", "--quiet"]
    done = CliRunner().invoke(app, [str(word) for word in fit])
    assert done.exit_code == 0, done.output
    result = read_fit(tmp_path / "fit")
    assert result.settings["surface"] == "wet"
    assert "landing gear with the wet law" in GearReport(tmp_path, result).verdict().text


def test_surfaces_are_declared():
    assert {"lf", "hf"} <= set(SURFACES)
    for name, surface in SURFACES.items():
        assert find_surface(name) is surface
        assert set(surface.reads) <= set(PARAMETERS)
        assert set(surface.free) <= set(PARAMETERS)
    assert [len(SURFACES[name].free) for name in ("lf", "hf")] == [8, 12]
    assert len({row.symbol for row in PARAMETERS.values()}) == len(PARAMETERS)
    assert parameters_on("hf")["kinetic_friction"].nominal == 0.87
    assert parameters_on("lf").nominal == PARAMETERS.nominal
    with pytest.raises(ValueError, match="memory"):
        Surface("x", ("kinetic_friction",), (), SURFACES["lf"].solve)
