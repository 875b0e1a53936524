"""The gear in other people's integrators: scipy, SUNDIALS (scikit-sundae) and MuJoCo, where installed.

scipy and SUNDIALS get our compiled right-hand side, so that only the stepping is compared; MuJoCo its own
model of the same bodies, springs and slope, with its own (soft) contact law and friction.
"""

import importlib.util
import math

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from paired import best, loosest, mean_nrmse
from sysid.gear.kernel import parameter_row
from sysid.gear.kernel.dynamics import accelerations, derived, feet, pose
from sysid.gear.kernel.geometry import normal_force
from sysid.gear.model import PARAMETERS, parameters_on
from sysid.gear.surfaces.low_friction import low_friction


def installed(name):
    """Whether an optional library is here."""
    return importlib.util.find_spec(name) is not None


@njit(error_model="numpy")
def thrust_at(t, segments):
    """Thrust of the rear and front pair [N] from the kernel's own segments (`Propulsion.segments`)."""
    piece = segments[np.searchsorted(segments[1:, 0], t, side="right")]
    s = t - piece[0]
    rear = piece[2] + s * (piece[3] + s * (piece[4] + s * piece[5]))
    front = piece[6] + s * (piece[7] + s * (piece[8] + s * piece[9]))
    return rear, front


@njit(error_model="numpy")
def body_rates(y, push, coefficients, k_s, b_s, law):
    """Rates (14,) of the state in the slope's frame under low friction, and how deep the lower foot is [m].

    push: acceleration of the body alone by thrust, along its own axis and in turn [m/s², rad/s²].
    """
    joints = pose(y[2], y[4], y[6], coefficients.dx_j, coefficients.dz_j)
    rates = (y[7], y[8], y[9], y[10], y[11], y[12], y[13])
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, y[1], y[3], y[5], rates, coefficients.length)
    n_c, n_d = normal_force(p_c, dp_c, k_s, b_s), normal_force(p_d, dp_d, k_s, b_s)
    f_c, f_d = low_friction(n_c, n_d, v_c, v_d, law)
    angles = (y[2], y[3], y[4], y[5], y[6])
    loads = (push[0], push[1], 0.0, 0.0, 0.0, 0.0)
    a = accelerations(joints, angles, rates, loads, (n_c, n_d), f_c, f_d, coefficients)
    out = np.empty(14)
    out[:7] = y[7:14]
    for i in range(7):
        out[7 + i] = a[i]
    return out, max(p_c, p_d)


@njit(error_model="numpy")
def derivative(t, y, coefficients, k_s, b_s, mu_k, eps_v, segments, lever):
    """Rates of the state in the slope's frame, for another library's integrator.

    Without segments the motors are off; lever: distance of the thrust points from the centre of mass [m].
    """
    rear, front = thrust_at(t, segments) if len(segments) else (0.0, 0.0)
    push = ((rear + front) * coefficients.per_m, (rear - front) * lever * coefficients.per_i)
    return body_rates(y, push, coefficients, k_s, b_s, (mu_k, eps_v, 0.0))[0]


def problem(slope, body, propulsion=None):
    """Right-hand side of t and y, start (14,) in the slope's frame, and the way back to x, z, q, vx, vz."""
    p = PARAMETERS.nominal
    coefficients = derived(np.array([p[name] for name in parameter_row.NAMES]), slope)
    c, s, rest = math.cos(slope), math.sin(slope), coefficients.q_n
    surface = (p["ground_stiffness"], p["ground_damping"], p["kinetic_friction"], p["slip_regularization"])
    x, z, q, dx, dz, dq = body
    phi = q - slope
    start = [c * x - s * z, s * x + c * z, phi, 0, phi + rest, 0, phi - rest]
    start = np.array([*start, c * dx - s * dz, s * dx + c * dz, dq, 0, dq, 0, dq], dtype=float)

    segments = np.zeros((0, 10)) if propulsion is None else propulsion.segments

    def right_hand_side(t, y):
        return derivative(t, y, coefficients, *surface, segments, p["thrust_point_dx"])

    def back(y):
        (x, z), (dx, dz) = ((c * a + s * b, c * b - s * a) for a, b in (y.T[:2], y.T[7:9]))
        return np.column_stack([x, z, y[:, 2] + slope, dx, dz])

    right_hand_side(0.0, start)
    return right_hand_side, start, back


def scipy_drop(method, slope, body, clock, exact):
    """Measure a scipy method on a drop."""
    right_hand_side, start, back = problem(slope, body)

    def attempt(rtol):
        run = solve_ivp(
            right_hand_side, (0, clock[-1]), start,
            method=method, t_eval=clock, rtol=rtol, atol=rtol * 1e-2,
        )  # fmt: skip
        return (back(run.y.T), int(run.nfev)) if run.y.shape[1] == len(clock) else None

    return loosest(attempt, exact, 2)


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
        run = solver.solve(clock, start)
        return (back(np.asarray(run.y)), count[0]) if len(run.t) == len(clock) else None

    return loosest(attempt, exact, 2)


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


def _begin(model, data, body):
    import mujoco

    mujoco.mj_resetData(model, data)
    data.qpos[:3] = body[:3]
    data.qvel[:3] = body[3:]


def mujoco_landing(slope, body, propulsion, horizon):
    """Processor time [s] of a powered landing in MuJoCo at steps of 1 ms, thrust set at every step."""
    import mujoco

    model = mujoco_model(slope)
    data = mujoco.MjData(model)
    clock = np.arange(round(horizon / 1e-3)) * 1e-3
    thrust = np.column_stack([propulsion.rear(clock), propulsion.front(clock)])

    def run():
        _begin(model, data, body)
        command = data.ctrl
        for now in thrust:
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
        _begin(model, data, body)
        out = np.empty((len(clock), 5))
        for n in range(len(clock)):
            out[n] = [*data.qpos[:3], *data.qvel[:2]]
            if n < len(clock) - 1:
                mujoco.mj_step(model, data, every)
        return out

    spent, out = best(run, 3)
    return {"seconds": spent, "error": mean_nrmse(out, exact), "rtol": math.nan, "rhs": steps}
