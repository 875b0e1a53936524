"""The exported MuJoCo model against the kernel: what it holds, free flight, vibrating legs, and a drop."""

import math
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from fakes.landings import values
from fakes.simulators import from_mjcf
from fakes.standing import tips_under_thrust, tips_without_thrust
from sysid.errors import ExportError
from sysid.export.mjcf import foot_inverse_mass, to_mjcf
from sysid.gear.model import simulate

mujoco = pytest.importorskip("mujoco", reason="the model of another simulator runs with the extra 'dev' only")


# Legs that differ at both ends, whose centre of mass is not in the middle.
UNEQUAL = {
    "front_leg_axial_stiffness_ratio": 0.7,
    "front_leg_axial_damping_ratio": 1.2,
    "front_leg_bending_stiffness_ratio": 1.6,
    "front_leg_bending_damping_ratio": 0.8,
    "front_leg_mass_ratio": 1.3,
    "front_leg_inertia_ratio": 0.9,
    "leg_mass_fraction": 0.35,
}


def load(document):
    model = mujoco.MjModel.from_xml_string(document.decode())
    return model, mujoco.MjData(model)


def run(document, start, clock, per_leg=False):
    """Body x, z, pitch and leg h_C q_C h_D q_D from their rest at a clock, from 14 coordinates and rates."""
    model, data = load(document)
    x, z, q, h_c, b_c, h_d, b_d, dx, dz, dq, dh_c, db_c, dh_d, db_d = start
    if per_leg:
        legs, rates = [b_c, h_c] * 2 + [b_d, h_d] * 2, [db_c, dh_c] * 2 + [db_d, dh_d] * 2
        data.qpos[:] = [x, 0, z, math.cos(q / 2), 0, math.sin(q / 2), 0, *legs]
        data.qvel[:] = [dx, 0, dz, 0, dq, 0, *rates]
    else:
        data.qpos[:] = [x, z, q, b_c, h_c, b_d, h_d]
        data.qvel[:] = [dx, dz, dq, db_c, dh_c, db_d, dh_d]
    every = round((clock[1] - clock[0]) / model.opt.timestep)
    body, out = model.body("body").id, []
    ends = ("rear_left", "front_left") if per_leg else ("rear", "front")
    for n in range(len(clock)):
        mujoco.mj_forward(model, data)
        turn = data.xquat[body]
        row = [data.xpos[body][0], data.xpos[body][2], 2 * math.atan2(turn[2], turn[0])]
        for end in ends:
            row += [data.joint(f"{end}_stretch").qpos[0], data.joint(f"{end}_bend").qpos[0]]
        out.append(row)
        if n < len(clock) - 1:
            mujoco.mj_step(model, data, every)
    return np.array(out)


def kernel(p, surface, slope, start, clock):
    """The same columns from the kernel."""
    rest = math.atan2(p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"])
    state = np.array(start, dtype=float)
    state[[4, 6]] += rest
    run = simulate(p, slope, None, clock, state=state, surface=surface, tolerance=1e-7)
    return run.state[:, :7] - [0, 0, 0, 0, rest, 0, rest]


def test_the_document_holds_the_set():
    p = values("lf", **UNEQUAL)
    document = to_mjcf(p, slope=0.3)
    assert from_mjcf(document) == p
    root = ElementTree.fromstring(document)
    joints = {j.get("name"): j for j in root.iter("joint")}
    for end, ratio in (("rear", dict.fromkeys(UNEQUAL, 1.0)), ("front", UNEQUAL)):
        for name, row in (("bend", "bending"), ("stretch", "axial")):
            for what in ("stiffness", "damping"):
                expected = p[f"leg_{row}_{what}"] * ratio[f"front_leg_{row}_{what}_ratio"]
                assert float(joints[f"{end}_{name}"].get(what)) == expected
    halves = {j.get("name"): j for j in ElementTree.fromstring(to_mjcf(p, per_leg=True)).iter("joint")}
    assert float(halves["rear_right_bend"].get("stiffness")) == p["leg_bending_stiffness"] / 2
    assert len([name for name in halves if name.endswith("_stretch")]) == 4


@pytest.mark.parametrize("per_leg", [False, True])
def test_mujoco_reads_the_same_masses(per_leg):
    p = values("lf", **UNEQUAL)
    model, _ = load(to_mjcf(p, per_leg=per_leg, slope=math.radians(20)))
    assert model.body_mass.sum() == pytest.approx(p["body_mass"] + 2.3 * p["leg_mass"], rel=1e-12)
    # MuJoCo's own inverse mass is what turns k_s into solref; a third of it would be a third of k_s.
    np.testing.assert_allclose(model.body_invweight0[2:, 0], foot_inverse_mass(p, per_leg), rtol=1e-9)
    share = 0.5 if per_leg else 1.0
    stiffness = -model.pair_solref[:, 0] / model.body_invweight0[2:, 0]
    np.testing.assert_allclose(stiffness, share * p["ground_stiffness"], rtol=1e-9)
    normal = np.zeros(9)
    mujoco.mju_quat2Mat(normal, model.geom("slope").quat)
    # The slope falls toward +x.
    np.testing.assert_allclose(
        normal.reshape(3, 3)[:, 2], [math.sin(math.radians(20)), 0, math.cos(math.radians(20))], atol=1e-12
    )


@pytest.mark.parametrize("per_leg", [False, True])
@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_free_flight_and_vibrating_legs_are_the_kernel_s(surface, per_leg):
    p = values(surface, **UNEQUAL)
    clock = np.arange(0, 0.2, 1e-3)
    start = [0.1, 5.0, 0.2, 2e-3, 0.05, -1e-3, -0.04, 0.5, -0.3, 1.0, 0, 0, 0, 0]
    ours = kernel(p, surface, 0.0, start, clock)
    theirs = run(to_mjcf(p, sticks=surface == "hf", per_leg=per_leg, timestep=2e-5), start, clock, per_leg)
    # Semi-implicit Euler: the error of a step of 20 µs on a leg that rings at 600 rad/s is 0.6 % of a radian.
    np.testing.assert_allclose(theirs[:, :3], ours[:, :3], atol=5e-4)
    np.testing.assert_allclose(theirs[:, 3::2], ours[:, 3::2], atol=2e-2 * np.abs(ours[:, 3::2]).max())
    np.testing.assert_allclose(theirs[:, 4::2], ours[:, 4::2], atol=2e-2 * np.abs(ours[:, 4::2]).max())


def frequency(clock, signal):
    """Of a decaying vibration, from its zero crossings [Hz]."""
    up = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    crossings = clock[up] - signal[up] * (clock[1] - clock[0]) / (signal[up + 1] - signal[up])
    assert len(crossings) >= 4
    return (len(crossings) - 1) / (crossings[-1] - crossings[0])


@pytest.mark.parametrize("surface", ["lf", "hf"])
@pytest.mark.parametrize("column", [3, 4])
def test_leg_frequencies_in_flight(surface, column):
    # Free of gravity's step and of the dampers: the mode alone, rear and front leg together.
    p = values(surface, leg_axial_damping=0.2, leg_bending_damping=1e-4)
    start = np.zeros(14)
    start[1] = 5.0
    start[[column, column + 2]] = 1e-3 if column == 3 else 0.02
    clock = np.arange(0, 0.15 if column == 3 else 0.4, 2e-4)
    ours = kernel(p, surface, 0.0, start, clock)[:, column]
    theirs = run(to_mjcf(p, sticks=surface == "hf"), start, clock)[:, column]
    # At the document's own time step.
    assert frequency(clock, theirs) == pytest.approx(frequency(clock, ours), rel=0.02)


@pytest.mark.parametrize(("surface", "slope", "speed"), [("lf", 15, 0.8), ("lf", 30, 0.5), ("hf", 20, 0.7)])
def test_a_drop_is_near_the_kernel_s(surface, slope, speed):
    p, angle = values(surface), math.radians(slope)
    document = to_mjcf(p, sticks=surface == "hf", slope=angle)
    model, _ = load(document)
    height = model.key_qpos[0, 1]
    assert height == pytest.approx(
        (p["foot_dx"] * math.sin(angle) + p["foot_dz"] * math.cos(angle)) / math.cos(angle)
    )
    assert model.key_ctrl.sum() == pytest.approx((p["body_mass"] + 2 * p["leg_mass"]) * p["gravity"])
    start = [0, height, 0, 0, 0, 0, 0, 0, -speed, 0, 0, 0, 0, 0]
    clock = np.arange(0, 0.15, 1e-3)
    ours = kernel(p, surface, angle, start, clock)
    theirs = run(document, start, clock)
    # Two laws of friction near zero slip; the same springs, so the same bounce: the first contacts turn the
    # body by some 20 deg and move it by 50 mm.
    stated = re.search(r"within ([\d.]+) mm and ([\d.]+) deg of sysid's for ([\d.]+) s", document.decode())
    distance, turn, duration = map(float, stated.groups())
    assert (distance, turn, duration) == (2.0, 0.6, 0.15)
    assert np.abs(theirs - ours)[:, :2].max() < 1e-3 * distance
    assert np.abs(theirs - ours)[:, 2].max() < math.radians(turn)
    in_space = run(to_mjcf(p, sticks=surface == "hf", slope=angle, per_leg=True), start, clock, per_leg=True)
    # Four halved legs are two pairs.
    np.testing.assert_allclose(in_space[:, :3], theirs[:, :3], atol=2e-4)


def test_a_standing_drone_sinks_and_stays():
    p = values("hf")
    slope = math.radians(15)
    model, data = load(to_mjcf(p, sticks=True, slope=slope))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:3] = [p["foot_dz"] * math.sin(slope), p["foot_dz"] * math.cos(slope), slope]
    data.ctrl[:] = 0
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    feet = [model.geom(f"{end}_foot").id for end in ("rear", "front")]
    places = data.geom_xpos[feet].copy()
    mujoco.mj_step(model, data, round(0.5 / model.opt.timestep))
    weight = (p["body_mass"] + 2 * p["leg_mass"]) * p["gravity"]
    force = np.zeros(6)
    total = 0.0
    for n in range(data.ncon):
        mujoco.mj_contactForce(model, data, n, force)
        # The law of the ground: a spring.
        assert force[0] == pytest.approx(-p["ground_stiffness"] * data.contact[n].dist, rel=5e-3)
        total += force[0]
    assert total == pytest.approx(weight * math.cos(slope), rel=1e-3)
    # It sticks, but for a creep of F R/B: 3 N on 7e4 N·s/m, 45 µm/s on the front feet.
    assert np.abs(data.geom_xpos[feet] - places).max() < 4e-5


@pytest.mark.parametrize("per_leg", [False, True])
def test_the_check_of_a_document_is_what_mujoco_does(per_leg):
    document = to_mjcf(values("hf"), sticks=True, per_leg=per_leg)
    load_stated, sink = map(
        float, re.search(r"carries ([\d.]+) N and sinks ([\d.]+) mm", document.decode()).groups()
    )
    model, data = load(document)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 0
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    force = np.zeros(6)
    assert data.ncon == len(model.pair_solref)
    for n in range(data.ncon):
        mujoco.mj_contactForce(model, data, n, force)
        # Friction that the settling legs left under sticking feet shifts a little of the weight.
        assert force[0] == pytest.approx(load_stated, rel=0.01)
        assert -1e3 * data.contact[n].dist == pytest.approx(sink, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("thrust", [0.0, 12.0])
def test_another_simulator_tips_where_the_balance_ends_on_a_slow_ramp(thrust):
    p = values("hf")
    model, data = load(to_mjcf(p, sticks=True))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = -thrust / 2
    mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
    begin, slope = data.time, 0.0
    # Gravity turns by 1 deg/s instead of the ground, without stairs and with the set's own dampers.
    while abs(data.qpos[2]) < math.radians(8.0):
        slope = math.radians(1.0) * (data.time - begin)
        assert slope < math.radians(60.0)
        model.opt.gravity[:] = [p["gravity"] * math.sin(slope), 0.0, -p["gravity"] * math.cos(slope)]
        mujoco.mj_step(model, data, 20)
    # Behind the limit the fall begins slowly, so the ramp is 0.6 to 1.2 deg further when it shows.
    balance = tips_under_thrust(p, thrust) if thrust else tips_without_thrust(p)
    late = math.degrees(slope - balance)
    assert 0.0 < late < 1.6


def test_refusals():
    with pytest.raises(ExportError, match="ground_stiffness"):
        to_mjcf(values("lf") | {"ground_stiffness": math.nan})
    with pytest.raises(ExportError, match="between"):
        to_mjcf(values("lf"), slope=1.6)
