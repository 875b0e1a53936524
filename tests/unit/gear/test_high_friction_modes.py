"""One decision of the high-friction law at a time: who sticks, who is released, and where it slips then."""

import numpy as np
import pytest

from sysid.gear.kernel import work_buffer as at
from sysid.gear.model import PARAMETERS, EventKind, pack, simulate
from sysid.gear.surfaces.high_friction import after_step
from sysid.integrate.tableau import STAGES

# At a load of 10 N: 8 N of kinetic, 9 N of static friction.
MU_K, EXCESS, LOAD = 0.8, 0.1, 10.0


def end_of_step(foot, at_foot, other):
    """Memory at the end of a step, rows of a foot and of the other one; the stages within it saw the same."""
    work = np.zeros(at.ROWS)
    work[at.LAW : at.LAW + 2] = MU_K, EXCESS
    for place, rows in ((foot, at_foot), (1 - foot, other)):
        for row, value in rows.items():
            work[row + place] = value
    for stage in range(STAGES - 1):
        first = at.INNER + at.INNER_ROWS * stage
        for row in (at.NORMAL, at.SLIP, at.REQUIRED):  # in the order of INNER_NORMAL, ...
            work[first : first + 2] = work[row : row + 2]
            first += 2
    return work


def decided(foot, *, stuck, way, slip, required, margin, load=LOAD, length=1e-8, seen=None):
    """State of a foot (stuck, way, switched) after a step in which nothing befalls the other; the step."""
    rows = {at.STUCK: stuck, at.WAY: way, at.SLIP: slip, at.NORMAL: load}
    # The other foot slips on far from a switch.
    slips = {at.WAY: 1.0, at.SLIP: 0.5, at.NORMAL: LOAD, at.REQUIRED: 5.0, at.MARGIN: 0.5}
    work = end_of_step(foot, rows | {at.REQUIRED: required, at.MARGIN: margin}, slips)
    if seen is not None:
        for stage in range(STAGES - 1):
            work[at.INNER + at.INNER_ROWS * stage + at.INNER_REQUIRED + foot] = seen
    step = after_step(work, 0, 1, length, 1.0, 1e-4)
    other = 1 - foot
    assert (work[at.STUCK + other], work[at.WAY + other], work[at.SWITCH + other]) == (0.0, 1.0, 0.0)
    return (work[at.STUCK + foot], work[at.WAY + foot], work[at.SWITCH + foot]), step


@pytest.mark.parametrize("foot", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_foot_whose_slip_ends_sticks_within_kinetic_friction(foot, sign):
    ends = {"stuck": 0.0, "way": sign, "slip": -1e-9 * sign, "margin": 1e-6}
    state, (taken, step) = decided(foot, **ends, required=7.9 * sign)
    assert state[0] == 1.0
    assert state[2] == 1.0
    assert (taken, step) == (1.0, 0.0)
    # Between kinetic and static friction it slips back: against the force that it lacks.
    assert decided(foot, **ends, required=8.1 * sign)[0] == (0.0, -sign, 1.0)
    assert decided(foot, **ends, required=-8.1 * sign)[0] == (0.0, sign, 1.0)
    # A slip that does not end changes nothing.
    slips = {"stuck": 0.0, "way": sign, "slip": 0.4 * sign, "margin": 0.5}
    assert decided(foot, **slips, required=0.0)[0] == (0.0, sign, 0.0)


@pytest.mark.parametrize("foot", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stuck_foot_is_released_beyond_static_friction(foot, sign):
    held = {"stuck": 1.0, "way": 1.0, "slip": 0.0, "margin": 1e-3}
    assert decided(foot, **held, required=8.9 * sign)[0] == (1.0, 1.0, 0.0)
    # Friction mu_k F_n sign(f_req) acts on it then: it slips the other way.
    assert decided(foot, **held, required=9.1 * sign)[0] == (0.0, -sign, 2.0)
    # In the air nothing holds it.
    assert decided(foot, **held, required=1e-3 * sign, load=0.0)[0][0] == 0.0


@pytest.mark.parametrize("foot", [0, 1])
def test_a_loss_within_a_step_repeats_it(foot):
    held = {"stuck": 1.0, "way": 1.0, "slip": 0.0}
    # Left over 1 N at the start, -1 N at the end: the first stage of the step saw -1 N already.
    state, (taken, step) = decided(foot, **held, required=10.0, margin=1.0, length=1e-4)
    assert state == (1.0, 1.0, 0.0)
    assert taken == 0.0
    assert 0.0 < step <= 0.5e-4 + 1e-7
    # A loss that heals before the end, which only the stages saw.
    healed = {"required": 8.0, "margin": 1.0, "seen": 10.0}
    assert decided(foot, **held, **healed, length=1e-4)[1][0] == 0.0
    # Such a step is cut, to no less than a tenth; below 1 us its end alone decides.
    assert decided(foot, **held, **healed, length=1e-4)[1][1] >= 1e-5
    assert decided(foot, **held, **healed, length=1e-7) == ((1.0, 1.0, 0.0), (1.0, 1e-4))


@pytest.mark.parametrize("shares", [(1.0, 1.0), (0.25, 0.75), (0.75, 0.25)])
def test_both_stuck_feet_may_be_released(shares):
    """At one instant both are, each against its own force; else the step ends at the earlier release."""
    stuck = {at.STUCK: 1.0, at.WAY: 1.0, at.NORMAL: LOAD}
    work = end_of_step(0, stuck, stuck)  # the stages within the step see no loss
    # Static friction of 9 N; what is left of it falls to -0.1 N within the step, through zero at the shares.
    work[at.REQUIRED : at.REQUIRED + 2] = 9.1, -9.1
    for foot, share in enumerate(shares):
        work[at.MARGIN + foot] = 0.1 * share / (1.0 - share) if share < 1.0 else 1e-12
    together = shares == (1.0, 1.0)
    length = 1e-8 if together else 1e-4
    taken, step = after_step(work, 0, 1, length, 1.0, 1e-4)
    if together:
        assert (taken, step) == (1.0, 0.0)
        assert work[at.STUCK : at.STUCK + 2].tolist() == [0.0, 0.0]
        assert work[at.SWITCH : at.SWITCH + 2].tolist() == [2.0, 2.0]
        assert work[at.WAY : at.WAY + 2].tolist() == [-1.0, 1.0]
    else:
        # A quarter of the step and the 0.05 us by which it ends behind the event; nothing has switched yet.
        assert taken == 0.0
        assert step == pytest.approx(0.25e-4 + 0.5e-7, rel=1e-9)
        assert work[at.STUCK : at.STUCK + 2].tolist() == [1.0, 1.0]
        assert work[at.SWITCH : at.SWITCH + 2].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("sticks", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_foot_may_stick_as_the_other_is_released(sticks, sign):
    """At one instant: each by its own force, as it was with both feet in their modes before."""
    releases, loaded = 1 - sticks, {at.NORMAL: LOAD, at.WAY: 1.0}
    held = loaded | {at.STUCK: 1.0, at.REQUIRED: 9.1 * sign, at.MARGIN: 1e-3}
    slips = loaded | {at.REQUIRED: 7.9 * sign, at.MARGIN: 1e-6, at.SLIP: -1e-9}
    work = end_of_step(releases, held, slips)
    assert after_step(work, 0, 1, 1e-8, 1.0, 1e-4) == (1.0, 0.0)
    assert (work[at.STUCK + sticks], work[at.SWITCH + sticks]) == (1.0, 1.0)
    assert (work[at.STUCK + releases], work[at.SWITCH + releases]) == (0.0, 2.0)
    # The released foot slips against the force that it lacks.
    assert work[at.WAY + releases] == -sign


def started(way, touching):
    """The first 1 ms of a drop of symmetric legs whose one foot (0 rear, 1 front) starts 0.1 mm deep.

    `way` +1: the slope falls toward +x and the drone moves up-slope at 0.5 m/s; -1: the mirror image.
    """
    slope, turn = np.radians(10.0), np.radians(3.0)
    row = pack({}, "hf")
    index = list(PARAMETERS).index
    dx, dz = row[index("foot_dx")], row[index("foot_dz")]
    # The deeper foot of the body turned by 3 deg from the slope: rear up, or front up.
    phi = turn if touching == 1 else -turn
    side = 1.0 if touching == 1 else -1.0
    normal = side * dx * np.sin(phi) + dz * np.cos(phi) - 1e-4
    body = [normal * np.sin(slope), normal * np.cos(slope), slope + phi, -0.5, -0.3, 0.0]
    signs = np.array([way, 1.0, way, way, 1.0, way])
    time = np.arange(0.0, 1.01e-3, 1e-4)
    run = simulate(row, way * slope, signs * body, time, surface="hf", tolerance=1e-6)
    return run, signs, row[index("kinetic_friction")]


@pytest.mark.parametrize("touching", [0, 1])
def test_a_foot_that_starts_in_contact_slips_the_way_it_moves(touching):
    down, _, mu_k = started(1.0, touching)
    up, signs, _ = started(-1.0, touching)
    for run, foot, force in ((down, touching, 1.0), (up, 1 - touching, -1.0)):
        assert run.normal_force[0, foot] == pytest.approx(11.0, rel=0.5)  # ground_stiffness x 0.1 mm, 15 N
        assert run.normal_force[0, 1 - foot] == 0.0
        # Moving along -x friction pulls to +x at once. It stops the light leg's foot after 0.4 ms, not
        # at once; between steps the log's friction is linear, which a curved normal force leaves by 2e-4.
        early = slice(0, 4)
        np.testing.assert_allclose(
            run.friction_force[early, foot], force * mu_k * run.normal_force[early, foot], rtol=1e-3
        )
        modes = [event.time for event in run.events if event.kind in (EventKind.STICK, EventKind.SLIP)]
        assert min(modes) > 3e-4
    # The mirror image, to rounding; legs change places.
    np.testing.assert_allclose(
        up.state[:, [0, 1, 2, 7, 8, 9]] * signs, down.state[:, [0, 1, 2, 7, 8, 9]], atol=1e-10
    )
    np.testing.assert_allclose(up.normal_force[:, ::-1], down.normal_force, atol=1e-6)
    np.testing.assert_allclose(-up.friction_force[:, ::-1], down.friction_force, atol=1e-6)
