"""The gear in other people's integrators: scipy, SUNDIALS (scikit-sundae) and MuJoCo, where installed.

scipy and SUNDIALS get our compiled right-hand side, so that only the stepping is compared; MuJoCo its own
model of the same bodies, springs and slope, with its own (soft) contact law and friction.
"""

import importlib.util
import math
import time

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from sysid.gear.kernel.dynamics import Coefficients, accelerations, feet, pose
from sysid.gear.kernel.geometry import normal_force
from sysid.gear.model import PARAMETERS, parameters_on
from sysid.gear.surfaces.low_friction import low_friction

# Mean NRMSE that a method must keep on a drop.
LIMIT = 1e-3
TOLERANCES = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)


def installed(name):
    """Whether an optional library is here."""
    return importlib.util.find_spec(name) is not None


def nrmse(ours, exact):
    """Mean NRMSE over x, z, q, vx, vz."""
    error = np.sqrt(np.mean((ours[:, :5] - exact[:, :5]) ** 2, axis=0)) / exact[:, :5].std(axis=0)
    return float(error.mean())


def best(call, repeats):
    """Least CPU time of the thread [s] and the last result."""
    spent, result = math.inf, None
    for _ in range(repeats):
        start = time.thread_time()
        result = call()
        spent = min(spent, time.thread_time() - start)
    return spent, result


@njit(error_model="numpy")
def thrust_at(t, segments):
    """Thrust of the rear and front pair [N] from the kernel's own segments (`Propulsion.segments`)."""
    own = segments[np.searchsorted(segments[1:, 0], t, side="right")]
    s = t - own[0]
    rear = own[2] + s * (own[3] + s * (own[4] + s * own[5]))
    front = own[6] + s * (own[7] + s * (own[8] + s * own[9]))
    return rear, front


@njit(error_model="numpy")
def derivative(t, y, coefficients, k_s, b_s, mu_k, eps_v, segments, lever):
    """Rates of the state in the slope's frame, for an integrator of somebody else.

    Without segments the motors are off; lever: distance of the thrust points from the centre of mass [m].
    """
    rear, front = thrust_at(t, segments) if len(segments) else (0.0, 0.0)
    push = ((rear + front) * coefficients.per_m, (rear - front) * lever * coefficients.per_i)
    joints = pose(y[2], y[4], y[6], coefficients.dx_j, coefficients.dz_j)
    rates = (y[7], y[8], y[9], y[10], y[11], y[12], y[13])
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, y[1], y[3], y[5], rates, coefficients.length)
    n_c = normal_force(p_c, dp_c, k_s, b_s)
    n_d = normal_force(p_d, dp_d, k_s, b_s)
    f_c, f_d = low_friction(n_c, n_d, v_c, v_d, (mu_k, eps_v))
    angles = (y[2], y[3], y[4], y[5], y[6])
    a = accelerations(joints, angles, rates, push, (n_c, n_d), f_c, f_d, coefficients)
    out = np.empty(14)
    out[:7] = y[7:]
    for i in range(7):
        out[7 + i] = a[i]
    return out


def problem(slope, body, propulsion=None):
    """Right-hand side of t and y, start (14,) in the slope's frame, and the way back to x, z, q, vx, vz."""
    p = PARAMETERS.nominal
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length, rest = math.hypot(span, depth), math.atan2(span, depth)
    c, s = math.cos(slope), math.sin(slope)
    names = ("axial_stiffness", "axial_damping", "bending_stiffness", "bending_damping")
    leg = [p[f"leg_{name}"] for name in names]
    inverse = (1 / p["leg_mass"], 1 / p["leg_inertia"])
    coefficients = Coefficients(
        *leg, *leg, p["joint_dx"], p["joint_dz"], length, rest, p["leg_mass_fraction"] * length,
        (1 - p["leg_mass_fraction"]) * length, 1 / p["body_mass"], 1 / p["body_inertia"], *inverse, *inverse,
        p["gravity"] * s, -p["gravity"] * c,
    )  # fmt: skip
    surface = (p["ground_stiffness"], p["ground_damping"], p["kinetic_friction"], p["slip_regularization"])
    x, z, q, dx, dz, dq = body
    phi = q - slope
    start = [c * x - s * z, s * x + c * z, phi, 0, phi + rest, 0, phi - rest]
    start = np.array([*start, c * dx - s * dz, s * dx + c * dz, dq, 0, dq, 0, dq], dtype=float)

    segments = np.zeros((0, 10)) if propulsion is None else propulsion.segments

    def right_hand_side(t, y):
        return derivative(t, y, coefficients, *surface, segments, p["thrust_point_dx"])

    def back(y):
        return np.column_stack(
            [
                c * y[:, 0] + s * y[:, 1],
                c * y[:, 1] - s * y[:, 0],
                y[:, 2] + slope,
                c * y[:, 7] + s * y[:, 8],
                c * y[:, 8] - s * y[:, 7],
            ]
        )

    right_hand_side(0.0, start)
    return right_hand_side, start, back


def _loosest(attempt, exact):
    """Time [s], error, tolerance, right-hand sides at the loosest tolerance that keeps the limit."""
    for rtol in TOLERANCES:
        spent, found = best(lambda rtol=rtol: attempt(rtol), 1)
        if found is None:
            continue
        ours, count = found
        error = nrmse(ours, exact)
        if error <= LIMIT:
            again, _ = best(lambda rtol=rtol: attempt(rtol), 2)
            return {"seconds": min(spent, again), "error": error, "rtol": rtol, "rhs": count}
    return {"seconds": math.nan, "error": math.nan, "rtol": math.nan, "rhs": 0}


def scipy_drop(method, slope, body, clock, exact):
    """Measure a scipy method on a drop."""
    right_hand_side, start, back = problem(slope, body)

    def attempt(rtol):
        found = solve_ivp(
            right_hand_side, (0, clock[-1]), start,
            method=method, t_eval=clock, rtol=rtol, atol=rtol * 1e-2,
        )  # fmt: skip
        return (back(found.y.T), int(found.nfev)) if found.y.shape[1] == len(clock) else None

    return _loosest(attempt, exact)


def sundials_drop(slope, body, clock, exact):
    """Measure SUNDIALS' CVODE (BDF, dense) on a drop."""
    from sksundae.cvode import CVODE

    right_hand_side, start, back = problem(slope, body)
    count = [0]

    def rates(t, y, out):
        count[0] += 1
        out[:] = right_hand_side(t, y)

    def attempt(rtol):
        count[0] = 0
        solver = CVODE(rates, method="BDF", rtol=rtol, atol=rtol * 1e-2, max_num_steps=100_000)
        found = solver.solve(clock, start)
        return (back(np.asarray(found.y)), count[0]) if len(found.t) == len(clock) else None

    return _loosest(attempt, exact)


def mujoco_model(slope, surface="lf"):
    """MuJoCo's model of the planar drone on two sprung legs, step of 1 ms."""
    import mujoco

    p = parameters_on(surface).nominal
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length, rest = math.hypot(span, depth), math.atan2(span, depth)
    bend = f'stiffness="{p["leg_bending_stiffness"]}" damping="{p["leg_bending_damping"]}"'
    slide = f'stiffness="{p["leg_axial_stiffness"]}" damping="{p["leg_axial_damping"]}"'
    legs = ""
    for name, side in (("rear", 1), ("front", -1)):
        legs += f"""
    <body name="{name}" pos="{-side * p["joint_dx"]} 0 {-p["joint_dz"]}" euler="0 {side * rest} 0">
      <joint type="hinge" axis="0 1 0" {bend}/>
      <joint type="slide" axis="0 0 -1" {slide}/>
      <inertial pos="0 0 {-0.5 * length}" mass="{p["leg_mass"]}" diaginertia="2e-4 2e-4 2e-4"/>
      <geom type="sphere" size="0.001" pos="0 0 {-length + 0.001}" mass="0" contype="1" conaffinity="2"
            friction="{p["kinetic_friction"]} 0 0" solref="-{p["ground_stiffness"]} -1"/>
    </body>"""
    text = f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 -{p["gravity"]}" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="5 5 1" euler="0 {slope} 0" contype="2" conaffinity="1"
          friction="{p["kinetic_friction"]} 0 0" solref="-{p["ground_stiffness"]} -1"/>
    <body name="drone">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="{p["body_mass"]}" diaginertia="0.0137 0.0137 0.0137"/>{legs}
      <site name="rear" pos="-{p["thrust_point_dx"]} 0 0"/>
      <site name="front" pos="{p["thrust_point_dx"]} 0 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="rear" gear="0 0 1 0 0 0"/><motor site="front" gear="0 0 1 0 0 0"/>
  </actuator>
</mujoco>"""
    return mujoco.MjModel.from_xml_string(text)


def mujoco_landing(slope, body, propulsion, horizon):
    """Processor time [s] of a powered landing in MuJoCo at steps of 1 ms, the thrust told at every step."""
    import mujoco

    model = mujoco_model(slope)
    data = mujoco.MjData(model)
    clock = np.arange(round(horizon / 1e-3)) * 1e-3
    told = np.column_stack([propulsion.rear(clock), propulsion.front(clock)])

    def run():
        mujoco.mj_resetData(model, data)
        data.qpos[:3] = body[:3]
        data.qvel[:3] = body[3:]
        command = data.ctrl
        for now in told:
            command[:] = now
            mujoco.mj_step(model, data)

    return best(run, 3)[0]


def mujoco_drop(slope, body, clock, exact, surface="lf"):
    """Measure MuJoCo at steps of 1 ms on a drop; its error is the distance of its contact law from ours."""
    import mujoco

    model = mujoco_model(slope, surface)
    data = mujoco.MjData(model)
    steps = round(clock[-1] / 1e-3)
    every = round((clock[1] - clock[0]) / 1e-3)

    def run():
        mujoco.mj_resetData(model, data)
        data.qpos[:3] = body[:3]
        data.qvel[:3] = body[3:]
        out = np.empty((len(clock), 5))
        for n in range(len(clock)):
            out[n] = [*data.qpos[:3], *data.qvel[:2]]
            if n < len(clock) - 1:
                mujoco.mj_step(model, data, every)
        return out

    spent, out = best(run, 3)
    return {"seconds": spent, "error": nrmse(out, exact), "rtol": math.nan, "rhs": steps}
