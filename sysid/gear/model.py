"""Planar drone on two sprung legs landing on a slope (Bass & Lussier Desbiens, equations 5-12).

Valid when roll and yaw stay small (the paper: below 10 deg); ignores aerodynamics of the body, the board's
own motion and everything out of the plane. Thrust, where given, acts along the body's z axis at ``(-+dx_m,
0)``; it comes as a history, because it does not depend on the motion (`sysid.gear.propulsion`).

Frame N: x down-slope to the right, z up, y into the page; positive pitch is nose-down. A slope of angle ``q_A
> 0`` falls toward +x; its surface passes through the origin. For an angle a: ``ex(a) = (cos a, -sin a)``,
``ez(a) = (sin a, cos a)``; the surface has the tangent ``ex(q_A)`` and the normal ``ez(q_A)``.

Each leg represents the *pair* of real legs at its end: rear C up-slope at -x, front D at +x.

=========  ============================================================================================
symbol     meaning [unit]
=========  ============================================================================================
x_B z_B    body's centre of mass in frame N [m]
q_B        pitch [rad]
h_C h_D    extension of the rear and front leg along its axis [m], 0 at rest
q_C q_D    angle of the rear and front leg from the body [rad], q_n at rest; absolute q_B + q_C, q_B - q_D
l, q_n     leg length and angle at rest, from the feet (dx_f, dz_f) and joints (dx_j, dz_j)
p, v_t     penetration of a foot [m] and its speed along the slope [m/s]
=========  ============================================================================================

Laws
----
Joint, axial (5): force ``-(k_h h + b_h h')`` on the body along the leg. Joint, bending (6): moment on the
body ``k_t (q_C - q_n) + b_t q_C'`` (rear; opposite sign for the front leg). The reaction across the leg is a
constraint force. Contact (7): ``F_n = k_s p + b_s p'`` while ``p > 0``, the damper only while ``p' > 0``. Low
friction (8): ``F_t = -mu_k F_n v_t / (|v_t| + eps_v)``. High friction (9, 10, Fig. 5): each foot slips
or sticks, `sysid.gear.surfaces.high_friction`. Motion (11, 12): `sysid.gear.kernel.dynamics`.

Where the printed paper cannot be meant literally: (8) lacks the minus sign (friction opposes slip); ``eps_v``
is not printed (0.01 m/s here); the leg's centre of mass is not given (`leg_mass_fraction` of the length from
the foot, the middle by default); the symbol ``k_t`` of the bending stiffness is the motor's torque constant
elsewhere in the paper.

Limits a reader can check: on a slope below ``atan mu_k`` the law creeps at ``eps_v r/(1 - r)``, ``r = tan
q_A/mu_k``; at rest the feet sink by ``m g/(2 k_s)`` each on level ground; in flight the whole keeps its
momentum.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import lru_cache
from types import MappingProxyType
from typing import Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import CampaignError
from sysid.gear.kernel import driver as kernel
from sysid.gear.kernel import parameter_row
from sysid.gear.parameters import PARAMETERS
from sysid.gear.propulsion import Propulsion, plans
from sysid.gear.surfaces import SURFACES, Surface, find_surface
from sysid.parallel import threads_for
from sysid.parameters import ParameterTable
from sysid.shown import Brief
from sysid.types import FloatArray, IntArray
from sysid.units import powers_of_unit

LF_FREE = SURFACES["lf"].free
COORDINATES = ("x_B", "z_B", "q_B", "h_C", "q_C", "h_D", "q_D")

# Bound of the weighted rms error of the seven rates per step that keeps every channel of the converged
# references within 1e-4 of its deviation. The tolerance that a fit needs is stated by each surface.
TIGHT_TOLERANCE = 1e-6
# Tolerance of a single drop whose switches of modes are logged: the steps of a fit pass over short releases.
_LOGGED_TOLERANCE = 3e-5
# Longest step [s].
_LONGEST_STEP = 5e-3
# First room for events of a single simulation, which is repeated with more room where there are more.
_MARKS = 1000
# Drops that one call of the population driver integrates side by side: one register of eight doubles where
# the CPU has it, two or four registers elsewhere.
_LANES = 8
_driver = lru_cache(maxsize=16)(kernel.drop_driver)
_force_reader = lru_cache(maxsize=8)(kernel.force_reader)


class Status(IntEnum):
    """How a simulated drop ended."""

    OK = kernel.OK
    STEP_COLLAPSED = kernel.STEP_COLLAPSED
    TOO_EXPENSIVE = kernel.TOO_EXPENSIVE
    BLEW_UP = kernel.BLEW_UP
    CAME_TO_REST = kernel.CAME_TO_REST
    FLIPPED_OVER = kernel.FLIPPED_OVER
    BOTH_TOUCHED = kernel.BOTH_TOUCHED

    @property
    def text(self) -> str:
        """Say what happened and what would help."""
        return {
            Status.OK: "integrated to the end",
            Status.STEP_COLLAPSED: "the step shrank below 1 ns: the parameters or the state are not physical",
            Status.TOO_EXPENSIVE: (
                "needed many times an ordinary drop's work: a contact or leg too stiff, or too many bounces "
                "and mode switches"
            ),
            Status.BLEW_UP: "a leg was pushed through its joint: the legs are too soft for this impact",
            Status.CAME_TO_REST: "ended at rest, as asked",
            Status.FLIPPED_OVER: "ended when it had flipped, as asked",
            Status.BOTH_TOUCHED: "ended when both feet had touched, as asked",
        }[self]


@dataclass(frozen=True)
class Ending:
    """When a drop is over, and what counts as rest and as a flip.

    A body that stays slow for a while is at rest, under thrust not before `Propulsion.settled`.
    """

    # The end of the clock; rest or a flip; rest, a flip or the touch of both feet.
    at: Literal["clock", "rest", "both feet"] = "clock"
    rest_speed: float = 0.05  # largest speed at rest [m/s]
    rest_turn: float = 0.2  # largest turn rate at rest [rad/s]
    rest_time: float = 0.2  # least time below both [s]
    flip_angle: float = math.radians(80.0)  # angle from the slope beyond which a body has flipped [rad]

    @property
    def packed(self) -> tuple[float, ...]:
        """What the kernel reads."""
        mode = ("clock", "rest", "both feet").index(self.at)
        return (float(mode), self.rest_speed, self.rest_turn, self.rest_time, self.flip_angle)


TO_THE_CLOCK = Ending()


class EventKind(IntEnum):
    """What happens to a foot, or to the body."""

    TOUCHDOWN = kernel.TOUCHDOWN
    LIFT_OFF = kernel.LIFT_OFF
    SLIP = kernel.SLIP
    STICK = kernel.STICK
    FLIP = kernel.FLIP
    REST = kernel.REST


@dataclass(frozen=True)
class Event:
    """One located event of a simulated drop, at a time since the drop's first sample [s].

    SLIP and STICK are the beginnings of those modes; `Ending` says what FLIP and REST are.
    """

    time: float
    kind: EventKind
    foot: Literal["rear", "front", "body"]


@dataclass(frozen=True, eq=False, repr=False)
class GearTrajectory(Brief):
    """One simulated drop on its sample times [s]; columns of forces and thrust are rear and front [N].

    Notes
    -----
    Columns of `switches`, the mode switches on a high-friction surface: time since the start [s], foot (0
    rear, 1 front), 1 if it sticks from then on and 0 if it slips, friction available to the rear and front
    foot and required by them [N]. The available friction belongs to the mode that the foot has or has just
    lost: mu_k F_n where a slip came to zero, mu_s F_n where a stuck foot was released. A slipping foot that
    fails to stick slips back: a row with 0 for a foot that had not stuck. A release that heals within a step
    may be missed (`sysid.gear.surfaces.high_friction`).
    """

    time: FloatArray
    state: FloatArray  # (n, 14) the seven `COORDINATES`, then their rates, frame N [SI]; NaN after a failure
    normal_force: FloatArray  # (n, 2) force of the surface on the feet along its normal
    friction_force: FloatArray  # (n, 2) the same down-slope
    status: Status
    reached: float  # time integrated before the end or a failure [s]
    rhs_evaluations: int
    switches: FloatArray  # (n_switches, 7), see Notes
    events: tuple[Event, ...]  # in the order of time, located to 1e-6 s at `TIGHT_TOLERANCE`
    thrust: FloatArray  # (n, 2)


@dataclass(frozen=True, eq=False)
class Drops:
    """Drops that every candidate is simulated on; refused with CampaignError where they make no sense."""

    slope: FloatArray  # (D,) angle of each surface [rad], positive falls toward +x
    body_state: FloatArray  # (D, 6) x_B, z_B, q_B and their rates at the first sample, frame N [SI]
    time: Sequence[FloatArray]  # D arrays of increasing sample times [s]; spacing may vary
    # Thrust of every drop, or of each; None: no thrust.
    propulsion: Propulsion | Sequence[Propulsion | None] | None = None
    clock: FloatArray = field(init=False)  # (n_total,) sample times since each drop's start [s]
    offset: IntArray = field(init=False)  # (D + 1,); drop d has the samples offset[d]:offset[d + 1]
    # The thrust as the kernel reads it.
    segments: FloatArray = field(init=False)
    plans: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        slope = _frozen(self.slope)
        body = _frozen(self.body_state)
        times = tuple(_frozen(t) for t in self.time)
        if slope.ndim != 1 or body.shape != (len(slope), 6) or len(times) != len(slope) or not len(slope):
            raise CampaignError(
                f"drops: found slopes {slope.shape}, initial states {body.shape} and {len(times)} clocks; "
                "give D slopes, (D, 6) states and D clocks"
            )
        for number, (angle, state, clock) in enumerate(zip(slope, body, times, strict=True)):
            if not (math.isfinite(angle) and abs(angle) < math.pi / 2 and np.isfinite(state).all()):
                raise CampaignError(
                    f"drop {number}: slope {angle:g} rad or initial state {state.tolist()} is not usable; "
                    "give finite numbers and a slope between -pi/2 and pi/2"
                )
            increasing = clock.ndim == 1 and np.isfinite(clock).all() and (np.diff(clock) > 0).all()
            if not (increasing and len(clock)):
                raise CampaignError(
                    f"drop {number}: sample times do not increase; give one or more increasing times"
                )
        given = self.propulsion
        each = (given,) * len(slope) if given is None or isinstance(given, Propulsion) else tuple(given)
        if len(each) != len(slope):
            raise CampaignError(
                f"drops: found {len(each)} propulsions for {len(slope)} drops; give one for all, or one each"
            )
        segments, plan = plans(each)
        derived = {
            "propulsion": each,
            "segments": _frozen(segments),
            "plans": _frozen(plan),
            "slope": slope,
            "body_state": body,
            "time": times,
            "clock": _frozen(np.concatenate([t - t[0] for t in times])),
            "offset": np.cumsum([0, *(len(t) for t in times)], dtype=np.int64),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class PopulationSamples:
    """What P candidates do on D drops; a state is x_B, z_B, q_B and their rates, frame N [SI]."""

    samples: FloatArray  # (P, n_total, 6) state at every sample, drop after drop; NaN after a failure
    reached: FloatArray  # (P, D) share of the drop's time integrated before a failure, 1 without one
    status: NDArray[np.int8]  # (P, D) `Status` codes
    rhs_evaluations: IntArray  # (P, D)
    # (P, D) mode switches on a high-friction surface; at a fit's tolerance up to a fifth of them are missed.
    switches: IntArray
    first_contact: FloatArray  # (P, D, 2) of the rear and front foot since the drop's start [s]; NaN: none
    flip: FloatArray  # (P, D) when the body flipped, by `Ending` [s]; NaN: never
    rest: FloatArray  # (P, D) from when on it stayed at rest, to a step's length [s]; NaN: never
    contact_state: FloatArray  # (P, D, 2, 6) state at the two first touchdowns
    end_state: FloatArray  # (P, D, 6) state at the end of the clock, at a failure, or at an earlier `Ending`
    marks: FloatArray  # (n, 7) the events of a single drop as the kernel writes them


def _frozen(values: ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def parameters_on(
    surface: str | Surface, vehicle: Mapping[str, float] = MappingProxyType({})
) -> ParameterTable:
    """Return the table with a surface's defaults and bounds, such as Table II's high-friction means.

    Defaults and bounds of the paper's F450 are scaled to the body_mass, foot_dx, foot_dz and gravity of
    `vehicle` [SI]: masses with its mass, lengths with its feet, times with the time that it takes to fall
    from their height. A value that `vehicle` lacks is the F450's, with which nothing changes.
    """
    law = find_surface(surface)
    default = {name: PARAMETERS[name].nominal for name in ("body_mass", "foot_dx", "foot_dz", "gravity")}
    ratio = {name: float(vehicle.get(name, value)) / value for name, value in default.items()}
    mass, length = ratio["body_mass"], math.sqrt(ratio["foot_dx"] * ratio["foot_dz"])
    time = math.sqrt(length / ratio["gravity"])
    along = {"joint_dx": "foot_dx", "thrust_point_dx": "foot_dx", "joint_dz": "foot_dz"}
    rows = []
    for name, row in PARAMETERS.items():
        if name in law.nominal:
            row = replace(row, nominal=law.nominal[name], source=f"{law.source}; bounds guessed")
        lower, upper = law.bounds.get(name, (row.lower, row.upper))
        row, powers = replace(row, lower=lower, upper=upper), powers_of_unit(row.unit)
        factor = mass ** powers[0] * length ** powers[1] * time ** powers[2]
        factor = ratio[along[name]] if name in along else factor
        if name != "gravity" and factor != 1.0:
            # How sharply friction sets in is a choice of the model, whatever the vehicle.
            nominal = row.nominal * (1.0 if name == "slip_regularization" else factor)
            row = replace(row.scaled(factor), nominal=nominal, source=f"{row.source}; scaled to the vehicle")
        rows.append(row)
    return ParameterTable(rows, PARAMETERS.derived)


def pack(values: Mapping[str, float], surface: str | Surface = "lf") -> FloatArray:
    """Lay values [SI] by name into a row (n_par,) of `PARAMETERS`; absent names take the surface's default.

    Raises CampaignError for an unknown name.
    """
    return np.array(list(parameters_on(surface).filled(values).values()))


def simulate(
    parameters: ArrayLike | Mapping[str, float],
    slope: float,
    body_state: ArrayLike | None,
    time: ArrayLike,
    *,
    state: ArrayLike | None = None,
    surface: str | Surface = "lf",
    tolerance: float | None = None,
    propulsion: Propulsion | None = None,
    ending: Ending = TO_THE_CLOCK,
) -> GearTrajectory:
    """Simulate one drop or landing and log its events.

    CampaignError if the input cannot be used; a simulation that fails returns its status instead.

    `parameters` are a row (n_par,) as from `pack`, or values by name [SI]; `slope` is the surface's angle
    [rad], `time` (n,) the sample times [s]. `body_state` (6,) are x_B, z_B, q_B and rates at ``time[0]``,
    frame N, the legs at rest in the body; or `state` (14,) has all coordinates and rates. The friction law is
    ``lf``, continuous (8), ``hf``, slipping and sticking feet (9, 10), or one of yours. `tolerance` bounds
    the weighted rms error of the rates per step: by default what a fit on the surface needs, and at most 3e-5
    where feet switch their modes: a fit's setting misses short releases.
    """
    law = find_surface(surface)
    if tolerance is None and law.switching:
        tolerance = min(law.tolerance, _LOGGED_TOLERANCE)
    if isinstance(parameters, Mapping):
        parameters = pack(parameters, law)
    rows = np.asarray(parameters, dtype=np.float64)[None]
    legs = np.empty(0)  # legs at rest in the body
    if state is not None:
        start = np.asarray(state, dtype=np.float64)
        if start.shape != (14,) or not np.isfinite(start).all():
            raise CampaignError(
                f"state: found shape {start.shape}; give 14 finite numbers, coordinates first"
            )
        coordinates, rates = start[:7], start[7:]
        body_state = np.concatenate([coordinates[:3], rates[:3]])
        legs = np.concatenate([coordinates[3:], rates[3:]])
    if body_state is None:
        raise CampaignError("simulate: no initial state; give body_state (6 numbers) or state (14 numbers)")
    body = np.atleast_2d(np.asarray(body_state, dtype=np.float64))
    clock = np.asarray(time, dtype=np.float64)
    drops = Drops(np.array([slope]), body, (clock,), propulsion)
    room = _MARKS
    while True:
        starts = (drops.body_state[None], legs)
        result = _run(rows, drops, starts, law, tolerance, columns=16, threads=1, ending=ending, room=room)
        if len(result.marks) < room:
            break
        room *= 8
    states = result.samples[0, :, :14]
    forces = np.empty((len(states), 4))
    _force_reader(law)(in_kernel_order(rows, law)[0], float(slope), states, forces)
    if law.switching:
        forces[:, 2:] = result.samples[0, :, 14:]
    thrust = np.zeros((len(clock), 2))
    if propulsion is not None:
        first = np.fmin.reduce(result.first_contact[0, 0], initial=np.inf)
        thrust = propulsion.at(clock - clock[0], float(first))
    marks = result.marks[np.argsort(result.marks[:, 0], kind="stable")]
    happened, kind, foot = marks[:, :3].T
    modes = np.isin(kind, (EventKind.SLIP, EventKind.STICK))
    names: tuple[Literal["rear", "front", "body"], ...] = ("rear", "front", "body")
    return GearTrajectory(
        time=clock,
        state=states,
        normal_force=forces[:, :2],
        friction_force=forces[:, 2:],
        status=Status(int(result.status[0, 0])),
        reached=float(result.reached[0, 0] * (clock[-1] - clock[0])),
        rhs_evaluations=int(result.rhs_evaluations[0, 0]),
        switches=np.column_stack([happened, foot, kind == EventKind.STICK, marks[:, 3:]])[modes],
        events=tuple(
            Event(float(t), EventKind(int(k)), names[int(f)])
            for t, k, f in zip(happened, kind, foot, strict=True)
        ),
        thrust=thrust,
    )


class Simulation(TypedDict):
    """Law, tolerance and threads of `simulate_population`, as a problem states them."""

    surface: str
    tolerance: float | None
    threads: int | None


def simulate_population(
    parameters: ArrayLike,
    drops: Drops,
    *,
    surface: str | Surface = "lf",
    tolerance: float | None = None,
    threads: int | None = None,
    body_states: ArrayLike | None = None,
    slopes: ArrayLike | None = None,
    ending: Ending = TO_THE_CLOCK,
) -> PopulationSamples:
    """Simulate candidates, rows (P, n_par) [SI] as from `pack`, on every drop; by default on all cores.

    The numbers do not depend on the number of threads nor on the candidates' order. A candidate that is lost
    ends with a status; nothing is raised. Samples later than an early end are NaN. Arguments as for
    `simulate`, but the default tolerance is always what a fit needs; `body_states` (P, D, 6) and `slopes`
    (P, D) are starts and surfaces of every candidate and drop, instead of one per drop.
    """
    rows = np.atleast_2d(np.asarray(parameters, dtype=np.float64))
    given = []
    for name, per_drop, stated in (
        ("body_states", drops.body_state, body_states),
        ("slopes", drops.slope, slopes),
    ):
        array = np.ascontiguousarray(per_drop[None] if stated is None else stated, dtype=np.float64).view()
        # Locked like the arrays in `Drops`: numba compiles a second driver for one that is not.
        array.flags.writeable = False
        if stated is not None and array.shape != (len(rows), *per_drop.shape):
            raise CampaignError(
                f"{name}: found {array.shape}, expected {(len(rows), *per_drop.shape)}; give one per "
                "candidate and drop"
            )
        given.append(array)
    bodies, angles = given
    return _run(
        rows, drops, (bodies, np.empty(0)), find_surface(surface), tolerance,
        columns=6, threads=threads, ending=ending, slopes=angles,
    )  # fmt: skip


def prepare(surface: str | Surface = "lf") -> None:
    """Compile a surface's driver, or load it from the disk cache.

    The first call after an installation compiles for some 10 s of processor time; say so before. Every
    simulation does it on demand.
    """
    law = find_surface(surface)
    drops = Drops(np.zeros(1), np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]]), [np.array([0.0, 1e-3])])
    simulate_population(pack({}, law), drops, surface=law)


def in_kernel_order(rows: FloatArray, surface: Surface) -> FloatArray:
    """Return rows (P, n_par) [SI] in the kernel's order, then the columns that the friction law reads."""
    index = PARAMETERS.index
    columns = [index[PARAMETERS[name].name] for name in (*parameter_row.NAMES, *surface.reads)]
    return np.ascontiguousarray(rows[:, columns])


def _run(
    rows: FloatArray,
    drops: Drops,
    start: tuple[FloatArray, FloatArray],
    surface: Surface,
    tolerance: float | None,
    *,
    columns: int,
    threads: int | None,
    ending: Ending = TO_THE_CLOCK,
    room: int = 0,
    slopes: FloatArray | None = None,
) -> PopulationSamples:
    """Simulate from the body's start (P or 1, D, 6) in frame N and the legs' (8,), empty for legs at rest.

    `slopes` (P or 1, D) replace the slopes of the drops.
    """
    slopes = drops.slope[None] if slopes is None else slopes
    if rows.ndim != 2 or rows.shape[1] != len(PARAMETERS):
        raise CampaignError(
            f"parameters: found rows of {rows.shape[-1]}, expected {len(PARAMETERS)}; build them with pack()"
        )
    if tolerance is None:
        tolerance = surface.tolerance
    if not 0 < tolerance < 1:
        raise CampaignError(
            f"tolerance: found {tolerance:g}, expected between 0 and 1; leave it out for "
            f"{surface.tolerance:g}"
        )
    count, width = len(rows), len(drops.slope)
    samples = np.full((count, len(drops.clock), columns), np.nan)
    reached, status = np.zeros((count, width)), np.zeros((count, width), dtype=np.int8)
    spent, switches = (np.zeros((count, width), dtype=np.int64) for _ in range(2))
    moments = np.full((count, width, 4), np.nan)
    states = np.full((count, width, 3, 6), np.nan)
    marks = np.full((room, 7), np.nan)
    kernel_rows = in_kernel_order(rows, surface)
    first, last = parameter_row.FIRST_TERM, len(parameter_row.NAMES)
    drive = _driver(_LANES, surface, bool(np.any(kernel_rows[:, first:last])))
    # A method of order 3 takes tolerance**(-1/3) more steps.
    cost = surface.budget * max(1.0, surface.tolerance / tolerance) ** (1 / 3)
    workers = threads_for(count * width, threads)
    # Drop by drop, so that lanes side by side cost alike.
    jobs = np.arange(count * width, dtype=np.int64).reshape(count, width).T.ravel()
    handed = np.zeros(1, dtype=np.int64)

    def work(_: int) -> None:
        drive(
            kernel_rows, slopes, *start, drops.clock, drops.offset, drops.segments, drops.plans,
            jobs, handed, tolerance, _LONGEST_STEP, cost, ending.packed, samples, reached, status, spent,
            switches, moments, states, marks,
        )  # fmt: skip

    if workers == 1 and len(jobs):
        work(0)
    elif workers > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, range(workers)))
    return PopulationSamples(
        samples=samples,
        reached=reached,
        status=status,
        rhs_evaluations=spent,
        switches=switches,
        first_contact=moments[:, :, :2],
        flip=moments[:, :, 2],
        rest=moments[:, :, 3],
        contact_state=states[:, :, :2],
        end_state=states[:, :, 2],
        marks=marks[np.isfinite(marks[:, 0])],
    )
