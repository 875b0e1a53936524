"""The motor of equations (1-3): table of parameters, curves, and simulation of one motor.

A brushless motor with its speed controller and propeller, seen as one winding, one rotor and three static
curves::

    L dI/dt = V_c − k_v Ω − R I                    V_c = k_v Ω_0(u) V/V_ref
    I_eff   = clip(I, ±I_sat)  while |Ω| < Ω_min and d|Ω|/dt > 0, judged with I;  else I
    I^r dΩ/dt = k_m I_eff − τ_aero(Ω) − k_d Ω

    T(Ω), τ_aero(Ω) = c2 Ω|Ω| + c1 Ω               Ω_0(u) = a u + b sign(u)

with one pair of coefficients per direction (a cambered propeller is weaker in reverse); the forward ones
serve Ω ≥ 0 and u > 0. V is the measured supply. A fit takes Ω_0(u) from the steady levels of its logs where
they are no line: Ω_0 = Ω_s + R (τ_s + k_d Ω_s)/(k_m k_v) of a level with speed Ω_s and drag τ_s. A load
cell under the motor feels the stator's reaction k_m I_eff − k_d Ω, positive when the motor drives the rotor
forward, and the thrust T, positive along the forward thrust.

Terms on trial, zero by default, for `sysid explain` (`sysid.motor.kind`)::

    R → (R + R_s u²) (1 + w ∫ I² dt)         V_c → V_c + V_dead (sign u − I/√(I² + 0.01 A²))

The supply carries u I on average, so that its resistance R_s counts with u² [2]_. Dead time takes a voltage
against the current [3]_; Ω_0(u) contains it while the current drives, so it shows in braking, twice. Copper
warms by the lost power, from the start of a trial on, without cooling: for seconds; w is 0.0039/K times R
over the winding's heat capacity [4]_. Neither cogging is a term, whose mean over a turn is zero and which
turns with kilohertz at flight speeds, nor dry friction of the rotor, which is in b of Ω_0(u).

Valid when the electrical commutation is much faster than L/R and the air is still; ignores axial and
radial airspeed, temperature, and any current limit or regeneration policy of the speed controller.

Notes
-----
Three printed points cannot be meant literally. Table I's k_v = k_t = 0.099 contradicts the 960 rpm/V of
the motor: `kv_to_si` gives 0.00995 V·s/rad, the nominal here. Equation (4) has the dimension of Ω²/V
instead of volt: V_c = k_v Ω_0(u) is what (1) needs at no load. L is printed in kg; it is in henry. The
torque constant is called k_m here because the paper uses k_t for the leg's torsional stiffness as well.

From torque and speed alone, (k, R, L, I_sat) → (c k, c² R, c² L, I_sat/c) with k = k_v = k_m changes
nothing; see `invariants`.

References
----------
Bass and Lussier Desbiens, Improving Multirotor Landing Performance on Inclined Surfaces Using Reverse
Thrust, section II-A.2, equations (1-4), Table I.

.. [2] Erickson and Maksimović, Fundamentals of Power Electronics, 2nd ed., 2001, chapter 3: losses on the
   input side of a converter count with the square of its duty cycle.
.. [3] Jeong and Park, The Analysis and Compensation of Dead-Time Effects in PWM Inverters, IEEE Transactions
   on Industrial Electronics 38(2), 1991.
.. [4] Hanselman, Brushless Permanent Magnet Motor Design, 2nd ed., 2003.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import FitError
from sysid.motor import kernel
from sysid.motor.parameters import FREE_DEFAULT, PARAMETERS, kv_to_si
from sysid.shown import Brief
from sysid.types import FloatArray

__all__ = [
    "FREE_DEFAULT", "PARAMETERS", "MotorTrajectory", "aerodynamic_torque", "invariants",
    "kernel_rows", "kv_to_si", "no_load_speed", "pack", "schedule", "simulate",
    "steady_state", "supply", "thrust", "thrust_slope", "unpack",
]  # fmt: skip


STATUS_TEXT = {
    kernel.DONE: "done",
    kernel.NO_STEADY_STATE: "no steady state under the first command",
    kernel.TOO_MANY_STEPS: f"more than {kernel.MAX_STEPS} steps, or a candidate's {kernel.CANDIDATE_STEPS}",
    kernel.NOT_FINITE: "the state became infinite",
    kernel.STUCK: "the step size fell to nothing",
}


# Relative local error of a step: 1e-6 keeps trajectories within 1e-6 of their scale.
TOLERANCE = 1e-6


def pack(parameters: Mapping[str, float]) -> FloatArray:
    """Return the row (n_table,) of numbers by name [SI]; a name left out takes its nominal.

    CampaignError when a name is not in the table.
    """
    return np.array(list(PARAMETERS.filled(parameters).values()))


def unpack(row: FloatArray, table: Iterable[str] = PARAMETERS) -> dict[str, float]:
    """Return the numbers of a row (n_table,) of a table by name [SI]."""
    return dict(zip(table, row.tolist(), strict=True))


def kernel_rows(rows: FloatArray) -> FloatArray:
    """Return what the kernel reads (..., n_reads) of rows of the table (..., n_table) [SI]."""
    index = PARAMETERS.index
    return np.ascontiguousarray(rows[..., [index[name] for name in kernel.READS]], dtype=np.float64)


def invariants(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return what torque and speed alone determine when Kv is unknown and no current is logged.

    ``k²/R`` [N·m·s/rad], ``R/L`` [1/s], ``k·I_sat`` [N·m] and the electromechanical time constant
    ``I^r R/k²`` [s], with k² = k_v k_m.
    """
    p = PARAMETERS.filled(parameters)
    k2 = p["back_emf_constant"] * p["torque_constant"]
    return {
        "k²/R": k2 / p["winding_resistance"],
        "R/L": p["winding_resistance"] / p["winding_inductance"],
        "k·I_sat": p["torque_constant"] * p["saturation_current"],
        "I^r R/k²": p["rotor_inertia"] * p["winding_resistance"] / k2,
    }


def thrust(speed: ArrayLike, parameters: Mapping[str, float]) -> FloatArray:
    """Return the static thrust T(Ω) [N] at speeds (...) [rad/s], positive forward."""
    return _odd_curve(speed, parameters, "thrust")


def aerodynamic_torque(speed: ArrayLike, parameters: Mapping[str, float]) -> FloatArray:
    """Return the static drag torque τ_aero(Ω) [N·m] at speeds (...) [rad/s], with the sign of the speed."""
    return _odd_curve(speed, parameters, "torque")


def thrust_slope(speed: ArrayLike, parameters: Mapping[str, float]) -> FloatArray:
    """Return dT/dΩ [N·s/rad] at speeds (...) [rad/s]."""
    quadratic, linear = _coefficients(speed, parameters, "thrust")
    return 2 * quadratic * np.abs(speed) + linear


def _odd_curve(speed: ArrayLike, parameters: Mapping[str, float], quantity: str) -> FloatArray:
    omega = np.asarray(speed, dtype=np.float64)
    quadratic, linear = _coefficients(omega, parameters, quantity)
    return (quadratic * np.abs(omega) + linear) * omega


def _coefficients(
    speed: ArrayLike, parameters: Mapping[str, float], quantity: str
) -> tuple[FloatArray, FloatArray]:
    """Return quadratic and linear coefficient (...) of a curve in the direction of each speed."""
    p, forward = PARAMETERS.filled(parameters), np.asarray(speed) >= 0
    quadratic, linear = (
        np.where(forward, p[f"{quantity}_{name}_forward"], p[f"{quantity}_{name}_reverse"])
        for name in ("quadratic", "linear")
    )
    return quadratic, linear


def no_load_speed(command: ArrayLike, parameters: Mapping[str, float]) -> FloatArray:
    """Return Ω_0(u) [rad/s] at V_ref for commands u (...) in [-1, 1]; the intercept never turns it round."""
    u, p = np.asarray(command, dtype=np.float64), PARAMETERS.filled(parameters)
    up = np.maximum(0.0, p["no_load_slope_forward"] * u + p["no_load_intercept_forward"])
    down = np.minimum(0.0, p["no_load_slope_reverse"] * u - p["no_load_intercept_reverse"])
    return np.where(u > 0, up, np.where(u < 0, down, 0.0))


def steady_state(
    command: ArrayLike, parameters: Mapping[str, float], voltage: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return current [A] and speed [rad/s] in equilibrium with a constant command, saturation aside.

    Commands u (...) in [-1, 1]; the supply (...) [V] is V_ref where left out.
    """
    p = PARAMETERS.filled(parameters)
    row = kernel_rows(pack(parameters))
    omega_0 = np.atleast_1d(no_load_speed(command, parameters))
    ratio = np.ones_like(omega_0) if voltage is None else np.asarray(voltage) / p["reference_voltage"]
    volts = np.broadcast_to(p["back_emf_constant"] * omega_0 * ratio, omega_0.shape)
    levels = np.broadcast_to(np.asarray(command, dtype=np.float64), omega_0.shape)
    each = zip(volts.ravel(), levels.ravel(), strict=True)
    pairs = np.array([kernel.steady_state(v, u, row) for v, u in each]).reshape(*omega_0.shape, 2)
    shape = np.shape(command)
    return pairs[..., 0].reshape(shape), pairs[..., 1].reshape(shape)


@dataclass(frozen=True, eq=False, repr=False)
class MotorTrajectory(Brief):
    """What a simulated motor did, (n,) each, over `time` [s].

    `current` is I of equation (1) and `effective_current` I_eff of (2) [A], `speed` Ω [rad/s], positive
    forward, `thrust` T(Ω) [N], and `stator_torque` k_m I_eff − k_d Ω [N·m], which a load cell under the motor
    feels.
    """

    time: FloatArray
    current: FloatArray
    effective_current: FloatArray
    speed: FloatArray
    thrust: FloatArray
    stator_torque: FloatArray


def simulate(
    parameters: Mapping[str, float],
    command_time: ArrayLike,
    command: ArrayLike,
    time: ArrayLike,
    *,
    initial: tuple[float, float] | Literal["steady"] = (0.0, 0.0),
    voltage: tuple[ArrayLike, ArrayLike] | None = None,
    ideal_reversal: bool = False,
    tolerance: float = TOLERANCE,
) -> MotorTrajectory:
    """Simulate one motor under a command schedule, sampled at given times.

    FitError when the simulation cannot reach the last time; the sentence says why and where.

    `parameters` by name [SI]; those left out take their nominal. `command_time` (m,) [s] are the instants
    from which each `command` (m,), u in [-1, 1], is in force; the first also serves before its instant, and
    ``command_delay`` is added to all. `time` (n,) are sample times [s], not decreasing. At the first of them
    the state is `initial`, a current [A] and a speed [rad/s]; "steady" takes the equilibrium under the
    command at that time. `voltage`, times [s] and volts [V], is a measured supply, linear between its samples
    and not delayed; without it the supply is V_ref. An `ideal_reversal` has no saturation (I_sat = ∞), as in
    Fig. 11. `tolerance` is the relative local error of a step.
    """
    t = np.ascontiguousarray(time, dtype=np.float64)
    instants, levels = schedule(command_time, command)
    p = PARAMETERS.filled(parameters)
    knots, ratio = supply(voltage, p["reference_voltage"])
    current, speed = (0.0, 0.0) if isinstance(initial, str) else (float(initial[0]), float(initial[1]))
    start = kernel.STEADY if isinstance(initial, str) else kernel.AS_GIVEN
    out = np.empty((t.size, 4))
    status, reached, _ = kernel.integrate(
        kernel_rows(pack(parameters)), instants, levels, np.full((levels.size, 2), np.nan), knots, ratio,
        t[0], t[-1], start, current, speed, tolerance, ideal_reversal, kernel.MAX_STEPS, t, out,
        *(np.empty(0),) * 4,
    )  # fmt: skip
    if status != kernel.DONE:
        raise FitError(
            f"motor simulation stopped at {t[0] + reached * (t[-1] - t[0]):.6g} s of {t[-1]:.6g} s: "
            f"{STATUS_TEXT[status]}; expected finite positive parameters, check {parameters!r}"
        )
    flow, effective, omega = (out[:, column].copy() for column in range(3))
    torque = p["torque_constant"] * effective - p["viscous_damping"] * omega
    return MotorTrajectory(t, flow, effective, omega, thrust(omega, parameters), torque)


def schedule(command_time: ArrayLike, command: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return a checked command schedule: instants [s] in order and u in [-1, 1], (m,) each."""
    instants = np.ascontiguousarray(np.atleast_1d(command_time), dtype=np.float64)
    levels = np.ascontiguousarray(np.atleast_1d(command), dtype=np.float64)
    if instants.shape != levels.shape or instants.size == 0 or np.any(np.diff(instants) < 0):
        raise FitError(
            f"command schedule has {instants.size} instants and {levels.size} commands; expected as many of "
            "each, in the order of time"
        )
    worst = float(np.max(np.abs(levels)))
    if not worst <= 1.0 + 1e-9:
        raise FitError(
            f"command schedule has u = {worst:g}; expected u in [-1, 1]: convert µs or DShot with the "
            "campaign's minimum, neutral and maximum"
        )
    return instants, levels


def supply(voltage: tuple[ArrayLike, ArrayLike] | None, reference: float) -> tuple[FloatArray, FloatArray]:
    """Return checked knots (k,) [s] of V/V_ref (k,) of a supply [V], or of the constant V_ref."""
    if voltage is None:
        return np.zeros(1), np.ones(1)
    knots = np.ascontiguousarray(voltage[0], dtype=np.float64)
    volts = np.ascontiguousarray(voltage[1], dtype=np.float64)
    if knots.shape != volts.shape or knots.size == 0 or np.any(np.diff(knots) <= 0) or not np.all(volts > 0):
        raise FitError(
            f"supply voltage has {knots.size} times and {volts.size} values; expected as many of each, times "
            "increasing and volts above 0"
        )
    return knots, volts / reference
