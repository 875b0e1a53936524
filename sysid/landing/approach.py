"""The way down before a landing: wind-free, with a simple attitude controller (section III-B)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.errors import CampaignError
from sysid.landing.drone import MOTORS_PER_PAIR, Drone, MotorState
from sysid.landing.settings import Scenario
from sysid.motor import model as motor_model
from sysid.types import FloatArray

# Natural frequency [rad/s] and damping ratio [1] of the proportional and derivative control of the pitch
# toward level, with instantaneous motors; a lag of some 40 ms takes some of the damping away.
FREQUENCY, DAMPING = 6.0, 1.2


@dataclass(frozen=True, eq=False)
class Descent:
    """How a descent ends."""

    touchdown: Scenario  # the first foot on the surface
    motors: MotorState  # at the touchdown
    duration: float  # of the descent [s]


def fly_down(drone: Drone, begin: Scenario, height: float) -> Descent:
    """Fly down until the first foot touches.

    `begin` is the slope and what the drone has at the beginning: pitch, rates, speed of descent. `height`
    is the way down of the body from there to its touchdown at that pitch [m]. Raises `CampaignError` when
    height or speed is not above 0, or the drone turns over or rises before it touches.

    The legs are rigid and their mass counts with the body's. The total thrust is the hovering one, so a level
    drone keeps its speed. Equations (1, 3) of both motor pairs are integrated with the flight (scipy, LSODA).
    """
    from scipy.integrate import solve_ivp

    if not (height > 0 and begin.speed > 0):
        raise CampaignError(
            f"descent: height {height:g} m, speed {begin.speed:g} m/s; give both above 0, or no height"
        )
    m = motor_model.PARAMETERS.nominal | dict(drone.motor)
    hover = drone.hover_command
    legs = drone.value("leg_mass") * (1.0 + drone.value("front_leg_mass_ratio"))
    mass = drone.value("body_mass") + legs
    reach = math.hypot(drone.value("foot_dx"), drone.value("foot_dz"))
    inertia = drone.value("body_inertia") + legs * 0.25 * reach**2
    arm, gravity = drone.value("thrust_point_dx"), drone.value("gravity")
    step = 1e-4
    low, high = (
        float(motor_model.thrust(motor_model.steady_state(hover + s * step, m)[1], m)) for s in (-1, 1)
    )
    lift = MOTORS_PER_PAIR * (high - low) / (2 * step)  # of a pair per command [N]
    gain = FREQUENCY**2 * inertia / (2 * arm * lift)
    rate_gain = 2 * DAMPING * FREQUENCY * inertia / (2 * arm * lift)

    def commands(y: FloatArray) -> tuple[float, float]:
        push = gain * y[2] + rate_gain * y[5]
        return float(np.clip(hover - push, 0.0, 1.0)), float(np.clip(hover + push, 0.0, 1.0))

    def rates(_: float, y: FloatArray) -> list[float]:
        pair = np.array(commands(y))
        current, speed = y[[6, 8]], y[[7, 9]]
        volts = m["back_emf_constant"] * (motor_model.no_load_speed(pair, m) - speed)
        winding = (volts - m["winding_resistance"] * current) / m["winding_inductance"]
        drag = motor_model.aerodynamic_torque(speed, m) + m["viscous_damping"] * speed
        spin = (m["torque_constant"] * current - drag) / m["rotor_inertia"]
        rear, front = MOTORS_PER_PAIR * motor_model.thrust(speed, m)
        total = rear + front
        return [
            y[3], y[4], y[5],
            total * math.sin(y[2]) / mass, total * math.cos(y[2]) / mass - gravity,
            arm * (rear - front) / inertia,
            winding[0], spin[0], winding[1], spin[1],
        ]  # fmt: skip

    def gap(_: float, y: FloatArray) -> float:
        """Height of the lower foot above the surface, along its normal."""
        turn = begin.slope - y[2]
        feet = drone.value("foot_dx") * abs(math.sin(turn)) + drone.value("foot_dz") * math.cos(turn)
        return float(y[0] * math.sin(begin.slope) + y[1] * math.cos(begin.slope) - feet)

    def lost(_: float, y: FloatArray) -> float:
        return 1.2 - abs(float(y[2]) - begin.slope)

    touch: Any = gap
    over: Any = lost
    touch.terminal = over.terminal = True
    touch.direction = -1
    start = drone.start(begin)
    start[1] += height
    current, speed = (float(v) for v in motor_model.steady_state(hover, m))
    longest = 10.0 * height / begin.speed
    flight: Any = solve_ivp(
        rates, (0.0, longest), [*start, current, speed, current, speed],
        method="LSODA", rtol=1e-8, atol=1e-9, events=[touch, over],
    )  # fmt: skip
    if not len(flight.t_events[0]):
        raise CampaignError(
            f"descent from {height:g} m at {begin.speed:g} m/s with a pitch of {math.degrees(begin.pitch):g} "
            "deg: the drone never touches down; begin nearer to level, or lower"
        )
    end = flight.y_events[0][0]
    drift, sink, turn = end[3:6].tolist()
    touchdown = Scenario(begin.slope, -sink, float(end[2]), turn, drift)
    motors = MotorState(commands(end), (float(end[6]), float(end[8])), (float(end[7]), float(end[9])))
    return Descent(touchdown, motors, float(flight.t_events[0][0]))
