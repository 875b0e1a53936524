"""The kernel's accelerations against a slow, obvious Newton-Euler twin and against a symbolic Lagrangian."""

import numpy as np
import pytest
import sympy as sp

from sysid.gear import contact, dynamics, hybrid
from sysid.gear.model import PARAMETERS, pack

NAMES = list(PARAMETERS)


def twin_forces(p, slope, state):
    """Normal and tangential force on the rear and front foot (2, 2), straight from (7) and (8), frame N."""
    x, z, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = state
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length = np.hypot(span, depth)
    tangent, normal = ex(slope), ez(slope)
    out = []
    for side, h, theta, dh, dtheta in (
        (1, h_c, q + q_c, dh_c, dq + dq_c),
        (-1, h_d, q - q_d, dh_d, dq - dq_d),
    ):
        joint = -side * p["joint_dx"] * ex(q) - p["joint_dz"] * ez(q)
        foot = np.array([x, z]) + joint - (length + h) * ez(theta)
        speed = np.array([dx, dz]) + dq * turned(joint) - dh * ez(theta) - (length + h) * dtheta * ex(theta)
        sink, sinking, slip = -foot @ normal, -speed @ normal, speed @ tangent
        force = 0.0
        if sink > 0:
            force = p["ground_stiffness"] * sink + (p["ground_damping"] * sinking if sinking > 0 else 0.0)
        friction = -p["kinetic_friction"] * abs(force) * slip / (abs(slip) + p["slip_regularization"])
        out.append((force, friction))
    return np.array(out)


def twin_accelerations(p, slope, state, forces):
    """Nine equations (11, 12) for seven accelerations and two joint reactions, solved as they stand."""
    _, _, q, h_c, q_c, h_d, q_d, _, _, dq, dh_c, dq_c, dh_d, dq_d = state
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length, rest = np.hypot(span, depth), np.arctan2(span, depth)
    weight = np.array([0.0, -p["gravity"]])
    # Unknowns: x'' z'' q'' | h_C'' theta_C'' | h_D'' theta_D'' | reactions on the legs.
    matrix, right = np.zeros((9, 9)), np.zeros(9)
    matrix[0, 0] = matrix[1, 1] = p["body_mass"]
    matrix[2, 2] = p["body_inertia"]
    right[:2] = p["body_mass"] * weight
    for leg, (side, h, angle, dh, dangle) in enumerate(
        ((1, h_c, q_c, dh_c, dq_c), (-1, h_d, q_d, dh_d, dq_d))
    ):
        theta, dtheta = q + side * angle, dq + side * dangle
        joint = -side * p["joint_dx"] * ex(q) - p["joint_dz"] * ez(q)
        rho = (1 - p["leg_mass_fraction"]) * length + h
        arm = p["leg_mass_fraction"] * length
        ground = forces[leg, 0] * ez(slope) + forces[leg, 1] * ex(slope)
        axial = -(p["leg_axial_stiffness"] * h + p["leg_axial_damping"] * dh) * ez(theta)  # on the body, (5)
        moment = side * (
            p["leg_bending_stiffness"] * (angle - rest) + p["leg_bending_damping"] * dangle
        )  # (6)
        reaction, ih, it = 7 + leg, 3 + 2 * leg, 4 + 2 * leg
        right[:2] += axial
        right[2] += moment + axial @ turned(joint)
        matrix[:2, reaction] += ex(theta)
        matrix[2, reaction] += ex(theta) @ turned(joint)
        # Leg: m a_CM = weight + ground - axial + reaction, a_CM = a_B + ... - h'' ez - rho theta'' ex + ...
        rows = slice(3 + 3 * leg, 5 + 3 * leg)
        m = p["leg_mass"]
        matrix[rows, 0], matrix[rows, 1] = (m, 0), (0, m)
        matrix[rows, 2] = m * turned(joint)
        matrix[rows, ih] = -m * ez(theta)
        matrix[rows, it] = -m * rho * ex(theta)
        matrix[rows, reaction] = -ex(theta)
        known = -(dq**2) * joint - 2 * dh * dtheta * ex(theta) + rho * dtheta**2 * ez(theta)
        right[rows] = m * weight + ground - axial - m * known
        # Leg about its centre of mass: the foot hangs `arm` below, the joint `rho` above.
        matrix[5 + 3 * leg, it] = p["leg_inertia"]
        matrix[5 + 3 * leg, reaction] = -ex(theta) @ turned(rho * ez(theta))
        right[5 + 3 * leg] = -moment + ground @ turned(-arm * ez(theta))
    return np.linalg.solve(matrix, right)[:7]


def ex(a):
    return np.array([np.cos(a), -np.sin(a)])


def ez(a):
    return np.array([np.sin(a), np.cos(a)])


def turned(r):
    """Velocity of a point r per rate of turn, z toward x."""
    return np.array([r[1], -r[0]])


def kernel(p, slope, state, forces=None):
    """Forces (2, 2) and accelerations (x z q h_C theta_C h_D theta_D) of the compiled functions, frame N."""
    x, z, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = map(float, state)
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length = float(np.hypot(span, depth))
    c, s = np.cos(slope), np.sin(slope)
    phi, theta_c, theta_d = q - slope, q + q_c - slope, q - q_d - slope
    rates = (float(c * dx - s * dz), float(s * dx + c * dz), dq, dh_c, dq + dq_c, dh_d, dq - dq_d)
    coefficients = (
        p["leg_axial_stiffness"], p["leg_axial_damping"], p["leg_bending_stiffness"],
        p["leg_bending_damping"], p["joint_dx"], p["joint_dz"], length, float(np.arctan2(span, depth)),
        p["leg_mass_fraction"] * length, (1 - p["leg_mass_fraction"]) * length, 1 / p["body_mass"], 1 /
        p["body_inertia"], 1 / p["leg_mass"], 1 / p["leg_inertia"], float(p["gravity"] * s),
        float(-p["gravity"] * c),
    )  # fmt: skip
    joints = dynamics.pose(phi, theta_c, theta_d, p["joint_dx"], p["joint_dz"])
    sink_c, dsink_c, slip_c, sink_d, dsink_d, slip_d = dynamics.feet(
        joints, float(s * x + c * z), h_c, h_d, rates, length
    )
    if forces is None:
        n_c = contact.normal_force(sink_c, dsink_c, p["ground_stiffness"], p["ground_damping"])
        n_d = contact.normal_force(sink_d, dsink_d, p["ground_stiffness"], p["ground_damping"])
        f_c, f_d = contact.low_friction(
            n_c, n_d, slip_c, slip_d, p["kinetic_friction"], p["slip_regularization"]
        )
        forces = np.array([(n_c, f_c), (n_d, f_d)])
    (n_c, f_c), (n_d, f_d) = forces.tolist()
    a = dynamics.accelerations(
        joints, phi, h_c, theta_c, h_d, theta_d, rates, n_c, n_d, f_c, f_d, coefficients
    )
    return forces, np.array([c * a[0] + s * a[1], c * a[1] - s * a[0], *a[2:]])


def random_cases(count, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        p = dict(zip(NAMES, pack({}).tolist(), strict=True))
        for name in NAMES[6:17]:
            row = PARAMETERS[name]
            p[name] = float(rng.uniform(row.lower, row.upper))
        slope = float(rng.uniform(-0.7, 0.7))
        scale = np.array([0.1, 0.02, 2.0, 0.01, 0.5, 0.01, 0.5, 1.0, 1.0, 10.0, 1.0, 20.0, 1.0, 20.0])
        state = scale * rng.uniform(-1, 1, 14)
        state[1] += rng.uniform(0.05, 0.2)
        yield p, slope, state


def test_against_newton_and_euler():
    touched = 0
    for p, slope, state in random_cases(200, seed=1):
        forces, ours = kernel(p, slope, state)
        expected = twin_forces(p, slope, state)
        # Forces of up to 1e4 N from differences of heights of 0.1 m: double precision leaves 1e-10 of them.
        np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)
        touched += bool(expected[:, 0].any())
        theirs = twin_accelerations(p, slope, state, expected)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())
    assert touched > 50  # the random states must exercise contact, not only flight


def foot_places(p, slope, q):
    """Places of both feet along the slope for coordinates (7,)."""
    x, z, b, h_c, q_c, h_d, q_d = q
    length = np.hypot(p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"])
    places = []
    for side, h, theta in ((1, h_c, b + q_c), (-1, h_d, b - q_d)):
        joint = np.array([x, z]) - side * p["joint_dx"] * ex(b) - p["joint_dz"] * ez(b)
        places.append((joint - (length + h) * ez(theta)) @ ex(slope))
    return np.array(places)


@pytest.mark.parametrize("modes", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_high_friction_in_every_mode(modes):
    """Multipliers hold stuck feet, judged by the twin and by finite differences of the feet's places."""
    for p, slope, state in random_cases(30, seed=3):
        normal = np.array([40.0, 25.0])
        ways = np.array([1.0, -1.0])

        def accelerations(friction, p=p, slope=slope, state=state, normal=normal):
            a = twin_accelerations(p, slope, state, np.column_stack([normal, friction]))
            return np.array(
                [*a[:3], a[3], a[4] - a[2], a[5], a[2] - a[6]]
            )  # of q_C and q_D, from absolute angles

        def feet(friction, t=2e-6, p=p, slope=slope, state=state, accelerations=accelerations):
            a = accelerations(friction)
            path = [foot_places(p, slope, state[:7] + s * state[7:] + s * s / 2 * a) for s in (-t, 0.0, t)]
            return (path[2] - path[0]) / (2 * t), (path[2] - 2 * path[1] + path[0]) / t**2

        speed, free = feet(np.zeros(2))
        rear, front = feet(np.array([1.0, 0.0]))[1] - free, feet(np.array([0.0, 1.0]))[1] - free
        f_c, f_d, _, _ = hybrid.high_friction(
            tuple(free),
            (rear[0], front[0], front[1]),
            tuple(normal),
            tuple(speed),
            *map(float, modes),
            *ways,
            0.8,
        )
        ours = compiled_feet(p, slope, state, normal, (f_c, f_d))
        for foot, (mode, force) in enumerate(zip(modes, (f_c, f_d), strict=True)):
            # Second differences over 2e-6 s leave 1e-3 m/s^2 of truncation and rounding.
            assert ours[foot] == pytest.approx(feet(np.array([f_c, f_d]))[1][foot], abs=1e-2, rel=1e-4)
            if mode:
                assert ours[foot] == pytest.approx(-200.0 * speed[foot], abs=1e-2, rel=1e-4)
            else:
                assert force == pytest.approx(-0.8 * normal[foot] * ways[foot])


def compiled_feet(p, slope, state, normal, friction):
    """Tangential accelerations of the feet from the compiled functions under given forces."""
    _, a = kernel(p, slope, state, np.column_stack([normal, friction]))
    _, _, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = map(float, state)
    c, s = float(np.cos(slope)), float(np.sin(slope))
    joints = dynamics.pose(q - slope, q + q_c - slope, q - q_d - slope, p["joint_dx"], p["joint_dz"])
    length = float(np.hypot(p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]))
    rates = (c * dx - s * dz, s * dx + c * dz, dq, dh_c, dq + dq_c, dh_d, dq - dq_d)
    own = (c * a[0] - s * a[1], s * a[0] + c * a[1], *a[2:])
    return hybrid.foot_accelerations(joints, h_c, h_d, length, rates, tuple(map(float, own)))


@pytest.fixture(scope="module")
def lagrangian():
    """Mass matrix and generalized forces without ground, derived from the energies alone."""
    t = sp.symbols("t")
    constants = sp.symbols("m i g dxj dzj kh bh kt bt ml il frac l qn")
    m, i, g, dxj, dzj, kh, bh, kt, bt, ml, il, frac, length, qn = constants
    q = [sp.Function(n)(t) for n in ("x", "z", "q", "hc", "qc", "hd", "qd")]
    fields = sp.symbols("nxc nzc nxd nzd")
    x, z, b, hc, qc, hd, qd = q
    ex_ = lambda a: sp.Matrix([sp.cos(a), -sp.sin(a)])  # noqa: E731
    ez_ = lambda a: sp.Matrix([sp.sin(a), sp.cos(a)])  # noqa: E731
    centre = sp.Matrix([x, z])
    kinetic = m * centre.diff(t).dot(centre.diff(t)) / 2 + i * b.diff(t) ** 2 / 2
    potential = m * g * z
    loss = 0
    feet = []
    for side, h, a in ((1, hc, qc), (-1, hd, qd)):
        theta = b + side * a
        joint = centre - side * dxj * ex_(b) - dzj * ez_(b)
        middle = joint - ((1 - frac) * length + h) * ez_(theta)
        feet.append(joint - (length + h) * ez_(theta))
        kinetic += ml * middle.diff(t).dot(middle.diff(t)) / 2 + il * theta.diff(t) ** 2 / 2
        potential += ml * g * middle[1] + kh * h**2 / 2 + kt * (a - qn) ** 2 / 2
        loss += bh * h.diff(t) ** 2 / 2 + bt * a.diff(t) ** 2 / 2
    v = [f.diff(t) for f in q]
    momentum = [sp.diff(kinetic, r) for r in v]
    work = feet[0].dot(sp.Matrix(fields[:2])) + feet[1].dot(sp.Matrix(fields[2:]))
    rates, coordinates = sp.symbols("v0:7"), sp.symbols("q0:7")
    put = lambda e: e.subs(dict(zip(v, rates, strict=True))).subs(dict(zip(q, coordinates, strict=True)))  # noqa: E731
    momentum = [put(e) for e in momentum]
    mass = sp.Matrix(7, 7, lambda a, c: sp.diff(momentum[a], rates[c]))
    force = []
    for a in range(7):
        drift = sum(sp.diff(momentum[a], coordinates[c]) * rates[c] for c in range(7))
        force.append(put(sp.diff(kinetic - potential + work, q[a])) - sp.diff(put(loss), rates[a]) - drift)
    return sp.lambdify((coordinates, rates, fields, constants), [mass, sp.Matrix(force)], cse=True)


def test_against_a_lagrangian(lagrangian):
    for p, slope, state in random_cases(50, seed=2):
        forces, ours = kernel(p, slope, state)
        ground = [forces[leg, 0] * ez(slope) + forces[leg, 1] * ex(slope) for leg in range(2)]
        span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
        constants = [
            p["body_mass"], p["body_inertia"], p["gravity"], p["joint_dx"], p["joint_dz"],
            p["leg_axial_stiffness"], p["leg_axial_damping"], p["leg_bending_stiffness"],
            p["leg_bending_damping"], p["leg_mass"], p["leg_inertia"], p["leg_mass_fraction"], np.hypot(span,
            depth), np.arctan2(span, depth),
        ]  # fmt: skip
        mass, force = lagrangian(state[:7], state[7:], np.concatenate(ground), constants)
        theirs = np.linalg.solve(mass, np.ravel(force))
        theirs[4] = theirs[2] + theirs[4]
        theirs[6] = theirs[2] - theirs[6]
        # Two exact derivations; what is left is the condition of the 7 x 7 mass matrix.
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())
