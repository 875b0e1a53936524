"""Drops of a fit, simulated once more with forces and legs, and the drone that every picture draws.

A fit keeps the five compared channels of every drop, and the state at the window's start. Legs and forces
come from a second simulation from that state. A page plays drops (`animation`): its script gets the numbers
from here and fetches nothing.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.errors import ExportError
from sysid.filters import runs
from sysid.fit.result import FitResult, TrialResult
from sysid.gear.model import simulate
from sysid.gear.stated import Moved
from sysid.report.drawing import USES, directions
from sysid.report.html import NOTHING, Html, filled
from sysid.report.plots import embedded
from sysid.types import BoolArray, FloatArray

# Rate of a replay [Hz]: contacts last some 10 ms.
RATE = 1000.0
# Step of the animation in samples of the replay.
_EVERY = 2
# Looks of the drone in shares of its arm: half width and height of the hull's top, height of a motor's mast,
# half length of a propeller.
_TOP, _HEIGHT, _MAST, _PROPELLER = 0.35, 0.14, 0.14, 0.47
# Longest flight between two touchdowns of one foot that count as one contact [s].
_ONE_CONTACT = 5e-3
# Speed below which a foot on high friction sticks [m/s]: integration leaves a stuck foot less
# speed than this, and a slip passes it within a millisecond.
_STICKS = 1e-3
# Key of a drop's state at the window's start in the provenance of a fit.
START = "initial_state"
FEET = ("rear", "front")


@dataclass(frozen=True, eq=False)
class Contact:
    """One stay of a foot (0 rear, 1 front) on the surface until it lifts off or the window ends [s]."""

    foot: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class DropReplay:
    """One drop with everything that can be drawn; frame N, the surface passes through the origin."""

    name: str
    use: str
    slope: float  # [rad]
    time: FloatArray  # (n,) since the window's start [s]
    body: FloatArray  # (n, 3) x_B, z_B [m] and pitch [rad]
    feet: FloatArray  # (n, 2, 2) rear and front foot, (x, z) [m]
    normal_force: FloatArray  # (n, 2) along the surface's normal, rear and front foot [N]
    friction_force: FloatArray  # (n, 2) down-slope [N]
    measured: FloatArray  # (n, 3) like `body`, linear between frames, NaN where lost
    contacts: tuple[Contact, ...]  # in the order of time
    values: dict[str, float]  # the simulated set by name [SI]
    slip_speed: FloatArray  # (n, 2) down-slope [m/s]

    @property
    def sticks(self) -> BoolArray:
        """Which foot (n, 2) is down and does not move along the slope: on high friction it sticks.

        The friction force does not tell: a sticking foot may need up to mu_s F_n, more than a slipping one.
        """
        return np.asarray((np.nan_to_num(self.normal_force) > 0.0) & (np.abs(self.slip_speed) < _STICKS))

    def first_contacts(self) -> tuple[tuple[float, str], ...]:
        """Return the instants (1) to (4) of Fig. 7 with what happens there; fewer where they do not come."""
        if not self.contacts:
            return ()
        first = self.contacts[0]
        other = next((c for c in self.contacts if c.foot != first.foot), None)
        last = float(self.time[-1])
        instants = []
        for contact in filter(None, (first, other)):
            leg = f"the {FEET[contact.foot]} leg"
            instants.append((contact.start, f"{leg} touches"))
            if contact.end < last:
                instants.append((contact.end, f"{leg} lifts off"))
        return tuple(sorted(instants))

    def index(self, time: float) -> int:
        """Return the sample nearest to an instant since the window's start [s]."""
        return int(np.argmin(np.abs(self.time - time)))


def replay_drop(fit: FitResult, trial: TrialResult) -> DropReplay:
    """Simulate one drop with a fit's best set; raise an ExportError where the fit lacks the drop's start."""
    log = fit.provenance.get("logs", {}).get(trial.name, {})
    if START not in log or "slope_deg" not in log:
        raise ExportError(
            f"{fit.name}, {trial.name}: the fit lacks the state in which the drop starts; fit again"
        )
    values = dict(zip((r.name for r in fit.parameters), map(float, fit.values[0]), strict=True))
    start = np.array(log[START], dtype=np.float64)
    # Release, centre of mass and surface were fitted within the errors that are stated of them.
    slope = float(np.radians(log["slope_deg"]))
    fitted = Moved.in_set(values, trial.name, slope, bool(log.get("held_before_release")))
    delay = float(np.nan_to_num(fitted.delays[0, 0]))
    start[:3] -= start[3:] * delay
    start[1] -= 0.5 * values["gravity"] * delay**2
    start[4] += values["gravity"] * delay
    start, slope = fitted.starts(start[None, None])[0, 0], float(fitted.slopes[0, 0])
    frames = trial.time - trial.time[0]
    time = np.arange(0.0, frames[-1] + 0.5 / RATE, 1.0 / RATE)
    columns = [fit.channels.index(name) for name in ("x_B", "z_B", "q_B")]
    seen = np.where(trial.valid, trial.measured, np.nan)[:, columns]
    measured = np.stack([np.interp(time, frames, each) for each in seen.T], axis=1)
    surface = str(fit.settings.get("surface", "lf"))
    tolerance = float(fit.settings.get("tolerance", 3e-4))
    # A parameter that an older fit lacks takes its default.
    run = simulate(values, slope, start, time, surface=surface, tolerance=tolerance)
    feet = foot_points(run.state, values)
    body = np.array(run.state[None, :, [0, 1, 2, 7, 8, 9]])
    fitted.as_captured(body, 0)
    # Feet are smooth in the coordinates: a difference over 0.1 us leaves an error of some 1e-7 m/s.
    instant = 1e-7
    moved = foot_points(run.state[:, :7] + instant * run.state[:, 7:], values)
    return DropReplay(
        trial.name, trial.use, slope, time, body=body[0, :, :3],
        feet=fitted.seen(feet[None], 0)[0], normal_force=run.normal_force, friction_force=run.friction_force,
        measured=measured, contacts=_contacts(time, run.normal_force), values=values,
        slip_speed=np.asarray((moved - feet) @ directions(slope)[0] / instant),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class DroneShape:
    """A drone at rest in side view, x forward and z up from the centre of mass, rear before front [m]."""

    joints: FloatArray
    feet: FloatArray
    hull: FloatArray
    # Arm, masts and propellers (5, 2, 2), each from point to point.
    rods: FloatArray


def drone_of(values: Mapping[str, float], scale: float = 1.0) -> DroneShape:
    """Return the drone of a set: joints and feet as fitted; hull, masts and propellers are only its looks."""

    def pair(x: float, z: float) -> FloatArray:
        return scale * np.array([[-x, z], [x, z]])

    arm = values["thrust_point_dx"]
    joints, feet = (pair(values[f"{part}_dx"], -values[f"{part}_dz"]) for part in ("joint", "foot"))
    ends, tips = pair(arm, 0.0), pair(arm, _MAST * arm)
    propeller = pair(_PROPELLER * arm, 0.0)
    rods = [ends, *zip(ends, tips, strict=True), *(tip + propeller for tip in tips)]
    hull = np.concatenate([joints, pair(-_TOP * arm, _HEIGHT * arm)])
    return DroneShape(joints, feet, hull, np.array(rods))


def placed(points: FloatArray, body: FloatArray) -> FloatArray:
    """Return points (..., 2) of the body's frame in frame N, for a body (..., 3) at x_B, z_B and pitch."""
    ex, ez = directions(body[..., 2])
    return np.asarray(body[..., :2] + points[..., :1] * ex + points[..., 1:] * ez)


def foot_points(state: FloatArray, values: Mapping[str, float]) -> FloatArray:
    """Return the feet (n, 2, 2) of states (n, 7 or 14), rear and front, in frame N [m]."""
    rest = drone_of(values)
    length = np.hypot(*(rest.feet - rest.joints)[1]) + state[:, [3, 5]]
    lean = np.stack([state[:, 2] + state[:, 4], state[:, 2] - state[:, 6]], axis=1)
    return placed(rest.joints, state[:, None, :3]) - length[..., None] * directions(lean)[1]


def _contacts(time: FloatArray, normal_force: FloatArray) -> tuple[Contact, ...]:
    contacts: list[Contact] = []
    for foot in (0, 1):
        of_foot: list[Contact] = []
        for first, end in runs(np.nan_to_num(normal_force[:, foot]) > 0.0):
            start, stop = float(time[first]), float(time[min(end, len(time) - 1)])
            if of_foot and start - of_foot[-1].end < _ONE_CONTACT:
                of_foot[-1] = Contact(foot, of_foot[-1].start, stop)
            else:
                of_foot.append(Contact(foot, start, stop))
        contacts += of_foot
    return tuple(sorted(contacts, key=lambda contact: contact.start))


def animation(scenes: Mapping[str, Mapping[str, DropReplay]], static: Html = NOTHING) -> Html:
    """Return drops to be played, stepped through and slowed down.

    Each drop has the key that its traces have; its replays by the name of their fit are played beside each
    other, the first one is judged. Nothing moves until a reader asks for it; where a system asks for reduced
    motion, playing steps from one instant of Fig. 7 to the next. `static` is what paper shows instead.
    """
    firsts = [next(iter(replays.items())) for replays in scenes.values()]
    # Drops of two campaigns may have one name.
    several = len({name for name, _ in firsts}) > 1
    choices = [
        f"{f'{name}, ' if several else ''}{drop.name}: {math.degrees(drop.slope):.0f}°, {USES[drop.use]}"
        for name, drop in firsts
    ]
    drops = [drop for _, drop in firsts]
    return filled(
        "animation.html.j2",
        names=", ".join(drop.name for drop in drops),
        choices=choices,
        steepest=steepest(drops),
        data=embedded({"drops": [_document(key, replays) for key, replays in scenes.items()]}),
        static=static,
    )


def steepest(drops: Sequence[DropReplay]) -> int:
    """Return which of some drops falls on the steepest slope: it is shown first."""
    return max(range(len(drops)), key=lambda i: drops[i].slope)


def _document(key: str, replays: Mapping[str, DropReplay]) -> dict[str, object]:
    """Return what the script draws, in whole numbers: lengths [0.1 mm], angles [0.1 mrad], forces [N]."""
    first, fits = next(iter(replays.values())), []
    for name, drop in replays.items():
        # A lost measurement is sent as 9 m, which the script leaves out: JSON has no NaN.
        measured = np.where(np.isfinite(drop.measured), drop.measured, 9.0)
        forces = drop.normal_force, drop.friction_force
        frames = np.column_stack([1e4 * drop.body, 1e4 * drop.feet.reshape(-1, 4), *forces, 1e4 * measured])
        drone = {part: _whole(1e4 * points) for part, points in vars(drone_of(drop.values)).items()}
        fits.append({"name": name, "frames": _whole(frames[::_EVERY]), "drone": drone})
    return {
        "key": key,
        "name": first.name,
        "use": USES[first.use],
        "slope": round(float(first.slope), 5),
        "step": _EVERY / RATE,
        "snapshots": [[round(t, 4), what] for t, what in first.first_contacts()],
        "contacts": [[c.foot, round(c.start, 4), round(c.end, 4)] for c in first.contacts],
        "fits": fits,
    }


def _whole(values: FloatArray) -> object:
    return np.rint(np.nan_to_num(values)).astype(int).tolist()
