"""The kernel's accelerations against a slow, obvious Newton-Euler twin and against a symbolic Lagrangian."""

import numpy as np
import pytest
import sympy as sp

from sysid.gear.kernel import dynamics, geometry, terms, work_buffer
from sysid.gear.model import PARAMETERS, pack
from sysid.gear.surfaces import high_friction, low_friction

NAMES = list(PARAMETERS)
TERMS = PARAMETERS.group("term")
LEG = ("axial_stiffness", "axial_damping", "bending_stiffness", "bending_damping", "mass", "inertia")


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
            rate = p["ground_damping"] + p["ground_stiffness"] * p["ground_rate_stiffening"] * sink
            force = p["ground_stiffness"] * sink + rate * max(sinking, 0.0)
        grip = p["kinetic_friction"] * (1.0 if side > 0 else 1.0 + p["front_friction_excess"])
        friction = -grip * abs(force) * slip / (abs(slip) + p["slip_regularization"])
        out.append((force, friction))
    return np.array(out)


def twin_accelerations(p, slope, state, forces, thrust=(0.0, 0.0)):
    """Nine equations (11, 12) for seven accelerations and two joint reactions, solved as they stand."""
    _, _, q, h_c, q_c, h_d, q_d, _, _, dq, dh_c, dq_c, dh_d, dq_d = state
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length, rest = np.hypot(span, depth), np.arctan2(span, depth)
    weight = np.array([0.0, -p["gravity"]])
    # Unknowns: x'' z'' q'' | h_C'' theta_C'' | h_D'' theta_D'' | reactions on the legs.
    matrix, right = np.zeros((9, 9)), np.zeros(9)
    matrix[0, 0] = matrix[1, 1] = p["body_mass"]
    matrix[2, 2] = p["body_inertia"]
    right[:2] = p["body_mass"] * weight + sum(thrust) * ez(q)
    right[2] = -p["pitch_drag"] * abs(dq) * dq
    for side, push in zip((1, -1), thrust, strict=True):
        right[2] += push * ez(q) @ turned(-side * p["thrust_point_dx"] * ex(q))
    for leg, (side, h, angle, dh, dangle) in enumerate(
        ((1, h_c, q_c, dh_c, dq_c), (-1, h_d, q_d, dh_d, dq_d))
    ):
        theta, dtheta = q + side * angle, dq + side * dangle
        joint = -side * p["joint_dx"] * ex(q) - p["joint_dz"] * ez(q)
        rho = (1 - p["leg_mass_fraction"]) * length + h
        arm = p["leg_mass_fraction"] * length
        ground = forces[leg, 0] * ez(slope) + forces[leg, 1] * ex(slope)
        k_h, b_h, k_t, b_t, m, inertia = leg_values(p)[leg]
        bend = angle - rest
        slide = k_h * p["leg_axial_hardening"] * h**3 + p["leg_slide_friction"] * dh / np.hypot(dh, 0.01)
        dry = p["leg_joint_friction"] * dangle / np.hypot(dangle, 0.1)
        axial = -(k_h * h + b_h * dh + slide) * ez(theta)  # on the body, (5)
        moment = side * (k_t * bend * (1 + p["leg_bending_hardening"] * bend**2) + b_t * dangle + dry)  # (6)
        reaction, ih, it = 7 + leg, 3 + 2 * leg, 4 + 2 * leg
        right[:2] += axial
        right[2] += moment + axial @ turned(joint)
        matrix[:2, reaction] += ex(theta)
        matrix[2, reaction] += ex(theta) @ turned(joint)
        # Leg: m a_CM = weight + ground - axial + reaction, a_CM = a_B + ... - h'' ez - rho theta'' ex + ...
        rows = slice(3 + 3 * leg, 5 + 3 * leg)
        matrix[rows, 0], matrix[rows, 1] = (m, 0), (0, m)
        matrix[rows, 2] = m * turned(joint)
        matrix[rows, ih] = -m * ez(theta)
        matrix[rows, it] = -m * rho * ex(theta)
        matrix[rows, reaction] = -ex(theta)
        known = -(dq**2) * joint - 2 * dh * dtheta * ex(theta) + rho * dtheta**2 * ez(theta)
        right[rows] = m * weight + ground - axial - m * known
        # Leg about its centre of mass: the foot hangs `arm` below, the joint `rho` above.
        matrix[5 + 3 * leg, it] = inertia
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


def coefficients_of(p, slope):
    """The coefficients, calculated without the kernel."""
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length = float(np.hypot(span, depth))
    c, s = np.cos(slope), np.sin(slope)
    rear, front = leg_values(p)
    return dynamics.Coefficients(
        *rear[:4], *front[:4], p["joint_dx"], p["joint_dz"], length, float(np.arctan2(span, depth)),
        p["leg_mass_fraction"] * length, (1 - p["leg_mass_fraction"]) * length, 1 / p["body_mass"],
        1 / p["body_inertia"], 1 / rear[4], 1 / rear[5], 1 / front[4], 1 / front[5],
        float(p["gravity"] * s), float(-p["gravity"] * c),
    )  # fmt: skip


def kernel(p, slope, state, forces=None, thrust=(0.0, 0.0)):
    """Forces (2, 2) and accelerations (x z q h_C theta_C h_D theta_D) of the compiled functions, frame N."""
    x, z, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = map(float, state)
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length = float(np.hypot(span, depth))
    c, s = np.cos(slope), np.sin(slope)
    phi, theta_c, theta_d = q - slope, q + q_c - slope, q - q_d - slope
    rates = (float(c * dx - s * dz), float(s * dx + c * dz), dq, dh_c, dq + dq_c, dh_d, dq - dq_d)
    coefficients = coefficients_of(p, slope)
    joints = dynamics.pose(phi, theta_c, theta_d, p["joint_dx"], p["joint_dz"])
    sink_c, dsink_c, slip_c, sink_d, dsink_d, slip_d = dynamics.feet(
        joints, float(s * x + c * z), h_c, h_d, rates, length
    )
    if forces is None:
        work = term_values(p)
        k_s, b_s = p["ground_stiffness"], p["ground_damping"]
        n_c = geometry.normal_force(sink_c, dsink_c, k_s, b_s + terms.approach(sink_c, k_s, work, 0, 1))
        n_d = geometry.normal_force(sink_d, dsink_d, k_s, b_s + terms.approach(sink_d, k_s, work, 0, 1))
        law = (p["kinetic_friction"], p["slip_regularization"], p["front_friction_excess"])
        f_c, f_d = low_friction.low_friction(n_c, n_d, slip_c, slip_d, law)
        forces = np.array([(n_c, f_c), (n_d, f_d)])
    (n_c, f_c), (n_d, f_d) = forces.tolist()
    angles = (phi, h_c, theta_c, h_d, theta_d)
    push = loads(p, thrust, angles, rates, coefficients)
    a = dynamics.accelerations(joints, angles, rates, push, (n_c, n_d), f_c, f_d, coefficients)
    return forces, np.array([c * a[0] + s * a[1], c * a[1] - s * a[0], *a[2:]])


def leg_values(p):
    """k_h b_h k_t b_t m_leg I_leg of the rear and of the front leg."""
    rear = [p[f"leg_{name}"] for name in LEG]
    return rear, [value * p[f"front_leg_{name}_ratio"] for value, name in zip(rear, LEG, strict=True)]


def term_values(p):
    """A work buffer of one lane with the terms' values."""
    work = np.zeros(work_buffer.ROWS)
    work[work_buffer.TERM_VALUES : work_buffer.TERM_VALUES + len(TERMS)] = [p[name] for name in TERMS]
    return work


def loads(p, thrust, angles, rates, coefficients):
    """What thrust of the rear and front motors and the terms add to the forces, as the kernel takes it."""
    rear, front = thrust
    *joint_forces, drag, _ = terms.added(angles, rates, coefficients, term_values(p), 0, 1)
    tilt = p["thrust_point_dx"] * (rear - front) / p["body_inertia"]
    return (rear + front) / p["body_mass"], tilt + drag, *joint_forces


def random_cases(count, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        p = dict(zip(NAMES, pack({}).tolist(), strict=True))
        for name in [*NAMES[6:17], *PARAMETERS.group("front leg", "term")]:
            row = PARAMETERS[name]
            p[name] = float(rng.uniform(row.lower, row.upper))
        slope = float(rng.uniform(-0.7, 0.7))
        scale = np.array([0.1, 0.02, 2.0, 0.01, 0.5, 0.01, 0.5, 1.0, 1.0, 10.0, 1.0, 20.0, 1.0, 20.0])
        state = scale * rng.uniform(-1, 1, 14)
        state[1] += rng.uniform(0.05, 0.2)
        yield p, slope, state


def test_against_newton_and_euler():
    touched = 0
    rng = np.random.default_rng(4)
    for p, slope, state in random_cases(200, seed=1):
        thrust = tuple(rng.uniform(-8, 8, 2).tolist())
        forces, ours = kernel(p, slope, state, thrust=thrust)
        expected = twin_forces(p, slope, state)
        # Forces of up to 1e4 N from differences of heights of 0.1 m: double precision leaves 1e-10 of them.
        np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)
        touched += bool(expected[:, 0].any())
        twin = twin_accelerations(p, slope, state, expected, thrust)
        np.testing.assert_allclose(ours, twin, rtol=0, atol=1e-9 * np.abs(twin).max())
    assert touched > 50  # the random states must exercise contact, not only flight


def fastest(p, slope, state):
    """Highest frequency of the linearized motion under the ground's and the legs' springs alone [rad/s]."""

    def pulled(q):
        full = np.concatenate([q, np.zeros(7)])
        forces = twin_forces(p, slope, full)
        forces[:, 1] = 0.0
        return twin_accelerations(p, slope, full, forces)[:7]

    step = np.diag([1e-6, 1e-6, 1e-5, 1e-6, 1e-5, 1e-6, 1e-5])
    slopes = [(pulled(state[:7] + d) - pulled(state[:7] - d)) / (2 * d.max()) for d in step]
    return np.sqrt(-np.linalg.eigvals(np.array(slopes).T).real.min())


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_a_leg_on_the_ground_rings_no_faster_than_estimated(surface):
    """It bounds the step: too slow an estimate lets steps grow unstable, one far too fast wastes them."""
    rng, ratios = np.random.default_rng(6), []
    for _ in range(40):
        p = dict(zip(NAMES, pack({}, surface).tolist(), strict=True))
        for name in ("leg_axial_stiffness", "ground_stiffness", "leg_mass", "leg_inertia"):
            p[name] *= rng.uniform(0.5, 2.0)
        slope, tilt = rng.uniform(0.0, 0.6), rng.uniform(-0.3, 0.3)
        rest = np.arctan2(p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"])
        # Deep enough for the lower foot, or both, to touch.
        state = np.zeros(14)
        state[[2, 4, 6]] = slope + tilt, rest + rng.uniform(-0.1, 0.1), rest + rng.uniform(-0.1, 0.1)
        state[:2] = rng.uniform(0.09, 0.13) * ez(slope)
        normals = tuple(twin_forces(p, slope, state)[:, 0].tolist())
        if not any(normals):
            continue
        _, _, q, _, q_c, _, q_d = state[:7].tolist()
        angles = (q - slope, q + q_c - slope, q - q_d - slope)
        joints = dynamics.pose(*angles, p["joint_dx"], p["joint_dz"])
        rate, damping = dynamics.ringing(
            joints, 0.0, 0.0, normals, p["ground_stiffness"], coefficients_of(p, slope)
        )
        rear = leg_values(p)[0]
        assert damping == pytest.approx(0.5 * rear[1] / rear[4] / rate, rel=1e-3)
        ratios.append(rate / fastest(p, slope, state))
    assert len(ratios) > 20
    # From above, as declared, and by no more than the other leg and the body's springs take off: found 1.005
    # to 1.095.
    assert min(ratios) > 1.0
    assert max(ratios) < 1.15


def slip_rates(p, slope, state, acceleration=None):
    """Speed of both feet along the slope (2,), or with accelerations (x z q h_C theta_C ...) theirs."""
    _, _, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = state
    length = np.hypot(p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"])
    out = []
    for leg, (side, h, theta, dh, dtheta) in enumerate(
        ((1, h_c, q + q_c, dh_c, dq + dq_c), (-1, h_d, q - q_d, dh_d, dq - dq_d))
    ):
        joint = -side * p["joint_dx"] * ex(q) - p["joint_dz"] * ez(q)
        if acceleration is None:
            foot = (
                np.array([dx, dz]) + dq * turned(joint) - dh * ez(theta) - (length + h) * dtheta * ex(theta)
            )
        else:
            foot = acceleration[:2] + acceleration[2] * turned(joint) - dq**2 * joint
            foot = foot - acceleration[3 + 2 * leg] * ez(theta) - 2 * dh * dtheta * ex(theta)
            turn = acceleration[4 + 2 * leg] * ex(theta) - dtheta**2 * ez(theta)
            foot = foot - (length + h) * turn
        out.append(foot @ ex(slope))
    return np.array(out)


@pytest.mark.parametrize("modes", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_high_friction_in_every_mode(modes):
    """The law's own solution against the nine equations with the stuck feet's constraints added."""
    mu, ways, thrust = 0.8, (1.0, -1.0), (4.0, -2.0)
    for p, slope, state in random_cases(60, seed=3):
        normal = np.array([40.0, 25.0])
        speed = slip_rates(p, slope, state)

        def twin(friction, p=p, slope=slope, state=state, normal=normal):
            return twin_accelerations(p, slope, state, np.column_stack([normal, friction]), thrust)

        free = twin(np.zeros(2))
        ones = [twin(unit) for unit in np.eye(2)]
        still = slip_rates(p, slope, state, free)
        response = np.column_stack([slip_rates(p, slope, state, one) - still for one in ones])
        friction = -mu * normal * ways
        stuck = np.flatnonzero(modes)
        if len(stuck):
            known = still + response @ np.where(np.array(modes) == 1, 0.0, friction)
            # A stuck foot's residual slip decays at 200 per second.
            wanted = -200.0 * speed - known
            friction[stuck] = np.linalg.solve(response[np.ix_(stuck, stuck)], wanted[stuck])
        expected = twin(friction)
        ours, forces, required, _ = compiled_high_friction(p, slope, state, normal, modes, ways, mu, thrust)
        scale = np.abs(friction).max()
        np.testing.assert_allclose(forces, friction, rtol=0, atol=1e-9 * max(scale, 40.0))
        # Two solutions of one linear problem; what is left is its condition.
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        for foot in stuck:
            assert required[foot] == pytest.approx(friction[foot], rel=1e-9, abs=1e-7)
        for foot in np.flatnonzero(np.array(modes) == 0):
            other = 1 - foot
            if modes[other]:
                both = np.linalg.solve(response, -still)[foot]
            else:
                both = -(still[foot] + response[foot, other] * friction[other]) / response[foot, foot]
            # What sticking would need with the other foot in its mode.
            assert required[foot] == pytest.approx(both, rel=1e-8, abs=1e-6)


def compiled_high_friction(p, slope, state, normal, modes, ways, mu, thrust):
    """Accelerations (x z q h_C theta_C h_D theta_D, frame N), friction and required friction of the law."""
    _, _, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = map(float, state)
    c, s = float(np.cos(slope)), float(np.sin(slope))
    joints = dynamics.pose(q - slope, q + q_c - slope, q - q_d - slope, p["joint_dx"], p["joint_dz"])
    rates = (c * dx - s * dz, s * dx + c * dz, dq, dh_c, dq + dq_c, dh_d, dq - dq_d)
    angles = (q - slope, h_c, q + q_c - slope, h_d, q - q_d - slope)
    slips = tuple(slip_rates(p, slope, state).tolist())
    coefficients = coefficients_of(p, slope)
    push = loads(p, thrust, angles, rates, coefficients)
    a, friction, required, stiff = high_friction.solve(
        joints, angles, rates, push, tuple(normal.tolist()), slips, (*map(float, modes), *ways),
        (mu, 0.1, 0.0, 0.0, 0.0, 0.0), coefficients,
    )  # fmt: skip
    return np.array([c * a[0] + s * a[1], c * a[1] - s * a[0], *a[2:]]), friction, required, stiff


@pytest.fixture(scope="module")
def lagrangian():
    """Mass matrix and generalized forces without ground, derived from the energies alone."""
    t = sp.symbols("t")
    constants = sp.symbols(
        "m i g dxj dzj frac l qn dxm tr tf kah kat fh mt cq khc bhc ktc btc mlc ilc khd bhd ktd btd mld ild"
    )
    m, i, g, dxj, dzj, frac, length, qn, dxm, t_r, t_f, harden, stiffen, slide, dry, drag = constants[:16]
    legs = (constants[16:22], constants[22:])
    q = [sp.Function(n)(t) for n in ("x", "z", "q", "hc", "qc", "hd", "qd")]
    fields = sp.symbols("nxc nzc nxd nzd")
    x, z, b, hc, qc, hd, qd = q
    ex_ = lambda a: sp.Matrix([sp.cos(a), -sp.sin(a)])  # noqa: E731
    ez_ = lambda a: sp.Matrix([sp.sin(a), sp.cos(a)])  # noqa: E731
    centre = sp.Matrix([x, z])
    kinetic = m * centre.diff(t).dot(centre.diff(t)) / 2 + i * b.diff(t) ** 2 / 2
    potential = m * g * z
    loss = drag * sp.sqrt(b.diff(t) ** 2) ** 3 / 3
    feet = []
    for side, h, a, (kh, bh, kt, bt, ml, il) in ((1, hc, qc, legs[0]), (-1, hd, qd, legs[1])):
        theta = b + side * a
        joint = centre - side * dxj * ex_(b) - dzj * ez_(b)
        middle = joint - ((1 - frac) * length + h) * ez_(theta)
        feet.append(joint - (length + h) * ez_(theta))
        kinetic += ml * middle.diff(t).dot(middle.diff(t)) / 2 + il * theta.diff(t) ** 2 / 2
        potential += ml * g * middle[1] + kh * h**2 / 2 + kt * (a - qn) ** 2 / 2
        potential += kh * harden * h**4 / 4 + kt * stiffen * (a - qn) ** 4 / 4
        loss += bh * h.diff(t) ** 2 / 2 + bt * a.diff(t) ** 2 / 2
        # Dry friction: the derivative of F sqrt(v² + v_0²) by v.
        loss += slide * sp.sqrt(h.diff(t) ** 2 + sp.Rational(1, 100) ** 2)
        loss += dry * sp.sqrt(a.diff(t) ** 2 + sp.Rational(1, 10) ** 2)
    v = [f.diff(t) for f in q]
    momentum = [sp.diff(kinetic, r) for r in v]
    work = feet[0].dot(sp.Matrix(fields[:2])) + feet[1].dot(sp.Matrix(fields[2:]))
    # Thrust along ez(q) at the two thrust points does the work of forces held in direction at the instant.
    push = sp.Matrix(sp.symbols("ux uz"))
    for side, thrust in ((1, t_r), (-1, t_f)):
        work += thrust * (centre - side * dxm * ex_(b)).dot(push)
    rates, coordinates = sp.symbols("v0:7"), sp.symbols("q0:7")
    put = lambda e: e.subs(dict(zip(v, rates, strict=True))).subs(dict(zip(q, coordinates, strict=True)))  # noqa: E731
    momentum = [put(e) for e in momentum]
    mass = sp.Matrix(7, 7, lambda a, c: sp.diff(momentum[a], rates[c]))
    force = []
    for a in range(7):
        drift = sum(sp.diff(momentum[a], coordinates[c]) * rates[c] for c in range(7))
        own_force = put(sp.diff(kinetic - potential + work, q[a]))
        own_force = own_force.subs(dict(zip(push, ez_(coordinates[2]), strict=True)))
        force.append(own_force - sp.diff(put(loss), rates[a]) - drift)
    return sp.lambdify((coordinates, rates, fields, constants), [mass, sp.Matrix(force)], cse=True)


def test_against_a_lagrangian(lagrangian):
    for p, slope, state in random_cases(50, seed=2):
        thrust = (7.0, -3.0)
        forces, ours = kernel(p, slope, state, thrust=thrust)
        ground = [forces[leg, 0] * ez(slope) + forces[leg, 1] * ex(slope) for leg in range(2)]
        span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
        rear, front = leg_values(p)
        constants = [
            p["body_mass"], p["body_inertia"], p["gravity"], p["joint_dx"], p["joint_dz"],
            p["leg_mass_fraction"], np.hypot(span, depth), np.arctan2(span, depth), p["thrust_point_dx"],
            *thrust, *(p[name] for name in TERMS if name != "ground_rate_stiffening"), *rear, *front,
        ]  # fmt: skip
        mass, force = lagrangian(state[:7], state[7:], np.concatenate(ground), constants)
        twin = np.linalg.solve(mass, np.ravel(force))
        twin[4] = twin[2] + twin[4]
        twin[6] = twin[2] - twin[6]
        # Two exact derivations; what is left is the condition of the 7 x 7 mass matrix.
        np.testing.assert_allclose(ours, twin, rtol=0, atol=1e-9 * np.abs(twin).max())
