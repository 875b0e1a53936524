"""Planar drone on two sprung legs landing on a slope (Bass & Lussier Desbiens, equations 5-12).

Valid when roll and yaw stay small (the paper: below 10 deg); ignores aerodynamics of the body, the board's
own motion and everything out of the plane. Motors off.

Frame N: x down-slope to the right, z up, y into the page; positive pitch is nose-down. A slope of angle ``q_A
> 0`` falls toward +x; its surface passes through the origin. For an angle a: ``ex(a) = (cos a, -sin a)``,
``ez(a) = (sin a, cos a)``; the surface has the tangent ``ex(q_A)`` and the normal ``ez(q_A)``.

Each leg stands for the *pair* of real legs at its end: rear C up-slope at -x, front D at +x.

=========  ==============================================================================================
symbol     meaning [unit]
=========  ==============================================================================================
x_B z_B    body's centre of mass in frame N [m]
q_B        pitch [rad]
h_C h_D    extension of the rear and front leg along its axis [m], 0 at rest
q_C q_D    angle of the rear and front leg from the body [rad], q_n at rest; absolute angles q_B + q_C, q_B -
q_D l, q_n     leg length and angle at rest, from the feet (dx_f, dz_f) and joints (dx_j, dz_j) p, v_t
penetration of a foot [m] and its speed along the slope [m/s] =========
==============================================================================================

Laws
----
Joint, axial (5): force ``-(k_h h + b_h h')`` on the body along the leg. Joint, bending (6): moment on the
body ``k_t (q_C - q_n) + b_t q_C'`` (rear; opposite sign for the front leg). The reaction across the leg is a
constraint force. Contact (7): ``F_n = k_s p + b_s p'`` while ``p > 0``, the damper only while ``p' > 0``. Low
friction (8): ``F_t = -mu_k F_n v_t / (|v_t| + eps_v)``. High friction (9, 10, Fig. 5): each foot slips
or sticks, `sysid.gear.hybrid`. Motion (11, 12): `sysid.gear.dynamics`.

Where the printed paper cannot be meant literally: (8) lacks the minus sign (friction opposes slip); ``eps_v``
is not printed (0.01 m/s here); the leg's centre of mass is not given (`leg_mass_fraction` of the length from
the foot, the middle by default); the symbol ``k_t`` of the bending stiffness is the motor's torque constant
elsewhere in the paper.

Limits a reader can check: on a slope below ``atan mu_k`` the law creeps at ``eps_v r/(1 - r)``, ``r = tan
q_A/mu_k``; at rest the feet sink by ``m g/(2 k_s)`` each on level ground; in flight the whole keeps its
momentum.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import CampaignError
from sysid.gear import kernel
from sysid.gear.trajectories import Drops, FloatArray, GearTrajectory, PopulationSamples, Status
from sysid.parameters import Parameter, ParameterTable

_MEASURED = "Table II, measured"
_LF = "Table II, low friction, mean of five fits"

# fmt: off
PARAMETERS = ParameterTable(
    [
        Parameter("body_mass", "m_B", "kg", 1.242, 0.1, 10.0, "log", "Mass without legs.", _MEASURED),
        Parameter(
            "body_inertia", "I_B", "kg·m²", 0.0137, 1e-4, 1.0, "log",
            "Moment of inertia of the body about its pitch axis.", _MEASURED,
        ),
        Parameter("gravity", "g", "m/s²", 9.81, 9.7, 9.9, "linear", "Gravity.", "standard value"),
        Parameter(
            "foot_dx", "dx_f", "m", 0.105, 0.02, 0.5, "linear",
            "Horizontal distance of the feet at rest from the centre of mass.", _MEASURED,
        ),
        Parameter(
            "foot_dz", "dz_f", "m", 0.151, 0.02, 0.5, "linear",
            "Depth of the feet at rest below the centre of mass.", _MEASURED,
        ),
        Parameter(
            "thrust_point_dx", "dx_m", "m", 0.225 * math.cos(math.pi / 4), 0.02, 1.0, "linear",
            "Horizontal distance of the motor pairs from the centre of mass.",
            "F450 in X configuration, arms of 0.225 m",
        ),
        Parameter(
            "joint_dx", "dx_j", "m", 0.088, 0.040, 0.100, "linear",
            "Horizontal distance of the leg joints from the centre of mass.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "joint_dz", "dz_j", "m", 0.024, 0.0, 0.060, "linear",
            "Depth of the leg joints below the centre of mass.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "leg_axial_stiffness", "k_h", "N/m", 6440.0, 2000.0, 12000.0, "log",
            "Axial spring of a pair of legs (buckling).", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "leg_axial_damping", "b_h", "N·s/m", 14.3, 1.0, 40.0, "log",
            "Axial damper of a pair of legs.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "leg_bending_stiffness", "k_t", "N·m/rad", 10.5, 1.0, 25.0, "log",
            "Bending spring of a pair of legs.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "leg_bending_damping", "b_t", "N·m·s/rad", 0.056, 0.001, 0.2, "log",
            "Bending damper of a pair of legs.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "ground_stiffness", "k_s", "N/m", 1.10e5, 2e4, 4e5, "log",
            "Contact spring of a pair of feet.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "ground_damping", "b_s", "N·s/m", 0.042, 0.001, 10.0, "log",
            "Contact damper of a pair of feet, active while they go deeper.", f"{_LF}; bounds guessed",
        ),
        Parameter(
            "leg_mass", "m_leg", "kg", 0.02, 0.005, 0.05, "log",
            "Mass of a pair of legs.", f"{_MEASURED}; bounds guessed",
        ),
        Parameter(
            "leg_inertia", "I_leg", "kg·m²", 2.0e-4, 2e-5, 1e-3, "log",
            "Moment of inertia of a pair of legs about their centre.", "Table II, calculated; bounds guessed",
        ),
        Parameter(
            "leg_mass_fraction", "f_leg", "1", 0.5, 0.1, 0.9, "linear",
            "Distance of a leg's centre of mass from its foot over the leg's length, at rest.",
            "guess: the middle of the leg",
        ),
        Parameter(
            "kinetic_friction", "μ_k", "1", 0.44, 0.1, 1.2, "linear",
            "Kinetic friction coefficient of the feet.", "Table II, measured on UHMW PE; bounds guessed",
        ),
        Parameter(
            "slip_regularization", "ε_v", "m/s", 0.01, 1e-3, 0.1, "log",
            "Slip speed at which low friction (8) reaches half of its limit.", "guess: the paper prints none",
        ),
        Parameter(
            "static_friction_excess", "μ_s − μ_k", "1", 0.08, 0.0, 0.3, "linear",
            "Static minus kinetic friction coefficient (high friction only).",
            "Table II, high friction, mean of five fits; bounds guessed",
        ),
        Parameter(
            "stick_speed", "e_v", "m/s", 1e-3, 1e-4, 1e-2, "log",
            "Slip speed below which the paper lets a foot stick; no effect here: zero slip is located.",
            "guess: the paper prints none",
        ),
    ]
)
# fmt: on

LF_FREE = (
    "joint_dx",
    "joint_dz",
    "leg_axial_stiffness",
    "leg_axial_damping",
    "leg_bending_stiffness",
    "leg_bending_damping",
    "ground_stiffness",
    "ground_damping",
)
HF_FREE = (*LF_FREE, "leg_mass", "leg_inertia", "kinetic_friction", "static_friction_excess")
COORDINATES = ("x_B", "z_B", "q_B", "h_C", "q_C", "h_D", "q_D")
SURFACES = ("lf", "hf")

# Bound of the weighted rms error of the seven rates per step. FIT keeps the mean NRMSE of a drop (5-35 deg,
# 0.4-1 m/s, 0.7 s) below 0.1 %, not by luck: on 360 drops scattered around six such cases as well. TIGHT
# keeps every channel of the converged references within 1e-4 of its deviation.
FIT_TOLERANCE = 3e-4
TIGHT_TOLERANCE = 1e-6

# Right-hand sides that a drop may spend per second of its length at FIT_TOLERANCE: about five times an
# ordinary one.
_COST = 5.8e4
_LONGEST_STEP = 5e-3
# Mode switches that a single simulation keeps.
_MARKS = 1000
# Lanes of the population driver: one register of eight doubles where the CPU has it, two or four registers
# elsewhere.
_LANES = 8


def pack(values: Mapping[str, float]) -> FloatArray:
    """Lay values [SI] into the kernel's row (n_par,), `PARAMETERS` order; absent names take the nominal.

    Raises
    ------
    CampaignError
        For an unknown name.
    """
    for name in values:
        PARAMETERS[name]
    return np.array([float(values.get(name, row.nominal)) for name, row in PARAMETERS.items()])


def simulate(
    parameters: ArrayLike | Mapping[str, float],
    slope: float,
    body_state: ArrayLike | None,
    time: ArrayLike,
    *,
    state: ArrayLike | None = None,
    surface: str = "lf",
    tolerance: float = FIT_TOLERANCE,
) -> GearTrajectory:
    """Simulate one drop without thrust.

    Parameters
    ----------
    parameters : (n_par,) array or mapping of str to float
        A row as from `pack`, or values by name.
    slope : float
        Angle of the surface [rad].
    body_state : (6,) array
        x_B, z_B, q_B and rates at time[0], frame N; the legs start at rest in the body.
    time : (n,) array
        Sample times [s].
    state : (14,) array, optional
        All coordinates and rates at time[0] instead of `body_state`.
    surface : {"lf", "hf"}
        Friction law: continuous (8), or the hybrid of slipping and sticking feet (9, 10).
    tolerance : float
        Bound of the weighted rms error of the rates per step.

    Raises
    ------
    CampaignError
        If the input cannot be used; a simulation that fails returns its status instead.
    """
    row = pack(parameters) if isinstance(parameters, Mapping) else np.asarray(parameters, dtype=np.float64)
    legs = np.empty(0)
    if state is not None:
        start = np.asarray(state, dtype=np.float64)
        if start.shape != (14,) or not np.isfinite(start).all():
            raise CampaignError(
                f"state: found shape {start.shape}; give 14 finite numbers, coordinates first"
            )
        body_state = start[[0, 1, 2, 7, 8, 9]]
        legs = np.ascontiguousarray(start[[3, 4, 5, 6, 10, 11, 12, 13]])
    if body_state is None:
        raise CampaignError("simulate: no initial state; give body_state (6 numbers) or state (14 numbers)")
    clock = np.asarray(time, dtype=np.float64)
    drops = Drops(np.array([slope]), np.atleast_2d(np.asarray(body_state, dtype=np.float64)), (clock,))
    result = _run(_checked(row[None]), drops, legs, surface, tolerance, lanes=1, columns=16, threads=1)
    states = result.samples[0, :, :14]
    forces = np.empty((len(states), 4))
    kernel.foot_forces(row, float(slope), states, forces)
    if surface == "hf":
        forces[:, 2:] = result.samples[0, :, 14:]
    return GearTrajectory(
        time=clock,
        state=states,
        normal_force=forces[:, :2],
        friction_force=forces[:, 2:],
        status=Status(int(result.status[0, 0])),
        reached=float(result.reached[0, 0] * (clock[-1] - clock[0])),
        rhs_evaluations=int(result.rhs_evaluations[0, 0]),
        switches=result.marks[: result.switches[0, 0]],
    )


def simulate_population(
    parameters: ArrayLike,
    drops: Drops,
    *,
    surface: str = "lf",
    tolerance: float = FIT_TOLERANCE,
    threads: int | None = None,
) -> PopulationSamples:
    """Simulate every candidate on every drop, on all cores.

    The numbers do not depend on the number of threads nor on the candidates' order. A candidate that is lost
    ends with a status; nothing is raised.

    Parameters
    ----------
    parameters : (P, n_par) array
        Rows as from `pack`.
    drops : Drops
        What each candidate is dropped on.
    surface : {"lf", "hf"}
        Friction law: continuous (8), or the hybrid of slipping and sticking feet (9, 10).
    tolerance : float
        Bound of the weighted rms error of the rates per step.
    threads : int, optional
        Number of threads; all cores by default.
    """
    rows = _checked(np.atleast_2d(np.asarray(parameters, dtype=np.float64)))
    return _run(rows, drops, np.empty(0), surface, tolerance, lanes=_LANES, columns=6, threads=threads)


def prepare(surface: str = "lf") -> None:
    """Compile both widths of a surface's driver, or load them from the disk cache.

    The first call after an installation compiles for up to half a minute per surface; say so before. Every
    simulation does it on demand.
    """
    drops = Drops(np.zeros(1), np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]]), [np.array([0.0, 1e-3])])
    simulate_population(pack({}), drops, surface=surface)
    simulate(pack({}), 0.0, drops.body_state[0], drops.time[0], surface=surface)


@lru_cache(maxsize=4)
def _driver(lanes: int, high: bool) -> Any:
    return kernel.drop_driver(lanes, high)


def _run(
    rows: FloatArray,
    drops: Drops,
    legs: FloatArray,
    surface: str,
    tolerance: float,
    *,
    lanes: int,
    columns: int,
    threads: int | None,
) -> PopulationSamples:
    if surface not in SURFACES:
        raise CampaignError(f"surface: no friction law {surface!r}; known are {', '.join(SURFACES)}")
    if not 0 < tolerance < 1:
        raise CampaignError(f"tolerance: found {tolerance:g}, expected between 0 and 1; use FIT_TOLERANCE")
    count, width = len(rows), len(drops.slope)
    samples = np.full((count, len(drops.clock), columns), np.nan)
    reached = np.zeros((count, width))
    status = np.zeros((count, width), dtype=np.int8)
    spent = np.zeros((count, width), dtype=np.int64)
    switches = np.zeros((count, width), dtype=np.int64)
    marks = np.empty((_MARKS if lanes == 1 else 0, 7))
    drive = _driver(lanes, surface == "hf")
    # A method of order 3 takes tolerance**(-1/3) more steps.
    cost = _COST * max(1.0, FIT_TOLERANCE / tolerance) ** (1 / 3)
    workers = max(1, min(threads or os.cpu_count() or 1, count * width))
    # Four shares per thread, dealt out drop by drop so that all cost alike; idle cores take the rest.
    shares = 1 if workers == 1 else 4 * workers
    deck = np.arange(count * width, dtype=np.int64).reshape(count, width).T.ravel()

    def work(share: int) -> None:
        jobs = np.ascontiguousarray(deck[share::shares])
        if len(jobs):
            drive(
                rows, drops.slope, drops.body_state, legs, drops.clock, drops.offset, jobs,
                tolerance, _LONGEST_STEP, cost, samples, reached, status, spent,
                switches, marks,
            )  # fmt: skip

    if workers == 1:
        work(0)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, range(shares)))
    return PopulationSamples(samples, reached, status, spent, switches, marks)


def _checked(rows: FloatArray) -> FloatArray:
    if rows.ndim != 2 or rows.shape[1] != len(PARAMETERS):
        raise CampaignError(
            f"parameters: found rows of {rows.shape[-1]}, expected {len(PARAMETERS)}; build them with pack()"
        )
    return np.ascontiguousarray(rows)
