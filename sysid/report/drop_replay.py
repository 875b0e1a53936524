"""Drops of a fit, simulated once more with forces and legs: what snapshots, animation and diagrams draw.

A fit keeps the five compared channels of every drop, and the state at the window's start. Legs and forces
come from a second simulation from that state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.errors import ExportError
from sysid.filters import runs
from sysid.fit.result import FitResult, TrialResult
from sysid.gear.model import simulate
from sysid.report.drawing import directions
from sysid.types import BoolArray, FloatArray

# Samples per second of a replay [Hz]: contacts last some 10 ms.
RATE = 1000.0
# Two touchdowns of one foot less than this apart are one contact [s].
_ONE_CONTACT = 5e-3
# Slower than this a foot on high friction sticks [m/s]: integration leaves a stuck foot less speed than this,
# and a slip passes it within a millisecond.
_STICKS = 1e-3
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
    """One drop with everything that can be drawn; frame N, the surface passes through the origin.

    Parameters
    ----------
    slope, time, values
        [rad]; (n,) since the window's start [s]; the simulated set by name [SI].
    body, measured : (n, 3) array
        x_B, z_B [m] and pitch [rad]; as measured linear between frames, NaN where lost.
    joints, feet : (n, 2, 2) array
        Rear and front, (x, z) [m].
    normal_force, friction_force, slip_speed : (n, 2) array
        Of the rear and the front foot, along the surface's normal or down-slope [N, m/s].
    contacts : tuple of Contact
        In the order of time.
    """

    name: str
    use: str
    slope: float
    time: FloatArray
    body: FloatArray
    joints: FloatArray
    feet: FloatArray
    normal_force: FloatArray
    friction_force: FloatArray
    measured: FloatArray
    contacts: tuple[Contact, ...]
    values: dict[str, float]
    slip_speed: FloatArray

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
    height, start = _start_of(values, trial.name, np.array(log[START], dtype=np.float64))
    slope = float(np.radians(log["slope_deg"]))
    span = float(trial.time[-1] - trial.time[0])
    time = np.arange(0.0, span + 0.5 / RATE, 1.0 / RATE)
    surface = str(fit.settings.get("surface", "lf"))
    tolerance = float(fit.settings.get("tolerance", 3e-4))
    # A row of the table that an older fit lacks takes its default.
    run = simulate(values, slope, start, time, surface=surface, tolerance=tolerance)
    joints, feet = leg_points(run.state, values)
    lift = np.array([0.0, height])
    return DropReplay(
        trial.name, trial.use, slope, time, body=run.state[:, :3] + [0.0, height, 0.0],
        joints=joints + lift, feet=feet + lift, normal_force=run.normal_force,
        friction_force=run.friction_force, measured=_measured(fit, trial, time),
        contacts=_contacts(time, run.normal_force), values=values,
        slip_speed=_slip_speed(run.state, values, slope),
    )  # fmt: skip


def leg_points(state: FloatArray, values: dict[str, float]) -> tuple[FloatArray, FloatArray]:
    """Return joints and feet (n, 2, 2) of states (n, 7 or 14), rear and front, in frame N [m]."""
    centre, q = state[:, :2], state[:, 2]
    ex, ez = directions(q)
    length = np.hypot(values["foot_dx"] - values["joint_dx"], values["foot_dz"] - values["joint_dz"])
    joints, feet = [], []
    for side, h, angle in ((-1.0, state[:, 3], q + state[:, 4]), (1.0, state[:, 5], q - state[:, 6])):
        joint = centre + side * values["joint_dx"] * ex - values["joint_dz"] * ez
        joints.append(joint)
        feet.append(joint - (length + h)[:, None] * directions(angle)[1])
    return np.stack(joints, 1), np.stack(feet, 1)


def _slip_speed(state: FloatArray, values: dict[str, float], slope: float) -> FloatArray:
    """Return the speed (n, 2) of the feet down the slope of states (n, 14) [m/s]."""
    # Feet are smooth in the coordinates: what 0.1 us leaves is some 1e-7 m/s.
    span = 1e-7
    moved = leg_points(state[:, :7] + span * state[:, 7:], values)[1] - leg_points(state[:, :7], values)[1]
    return np.asarray(moved @ directions(slope)[0] / span)


def _start_of(values: dict[str, float], name: str, state: FloatArray) -> tuple[float, FloatArray]:
    """Return a drop's height offset, if any, and its start shifted by its offsets of height and time."""
    height = values.get(f"height_offset[{name}]", 0.0)
    delay = values.get(f"start_offset[{name}]", 0.0)
    out = state.copy()
    out[:3] -= state[3:] * delay
    out[1] -= 0.5 * values["gravity"] * delay**2 + height
    out[4] += values["gravity"] * delay
    return height, out


def _measured(fit: FitResult, trial: TrialResult, time: FloatArray) -> FloatArray:
    out = np.full((len(time), 3), np.nan)
    frames = trial.time - trial.time[0]
    for column, name in enumerate(("x_B", "z_B", "q_B")):
        c = fit.channels.index(name)
        values = np.where(trial.valid[:, c], trial.measured[:, c], np.nan)
        out[:, column] = np.interp(time, frames, values)
    return out


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
