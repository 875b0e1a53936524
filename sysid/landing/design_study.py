"""What a changed design buys: the steepest slope that a drone lands on, over its legs, feet and motors.

Every change multiplies one number of the sets (legs, feet, body, motors), or adds to the pause of a thrust
reversal; each value of it is flown by every set over a grid of slopes and touchdown speeds, one change at a
time, or two together on a grid.

Valid for changes that leave the identified model what it is: a leg of half the stiffness is taken to be a
leg of the same mass and inertia. The paper names this study as future work.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from sysid.errors import CampaignError
from sysid.gear.model import PARAMETERS as GEAR
from sysid.landing.controllers import Controller, read_number
from sysid.landing.drone import Drone
from sysid.landing.maps import landing_maps
from sysid.landing.outcomes import LANDED, OUTCOMES, Outcome
from sysid.landing.settings import StudySettings
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.resume import Computing
from sysid.types import BoolArray, FloatArray, IntArray

Kind = Literal["gear", "motor", "reversal"]

REVERSAL = "reversal_delay"
# Largest number of values of one change.
_MOST = 41
# Example in a refusal, by whether a single value is asked for.
_ASKED = {False: "--vary k_t=0.5:2:5", True: "--change k_t=1.5"}


@dataclass(frozen=True)
class Change:
    """One number of the design and the values that it takes.

    `name` is a row of the gear's or the motor's table, or ``reversal_delay``; `symbol` is for tables and
    figures. `values` are factors on the value of the sets [1], or what is added to the reversal delay [s].
    """

    name: str
    symbol: str
    kind: Kind
    values: tuple[float, ...]

    @property
    def neutral(self) -> float:
        """The value that leaves the sets as they are."""
        return 0.0 if self.kind == "reversal" else 1.0

    @property
    def axis(self) -> tuple[float, ...]:
        """Its values in order, with the neutral one among them."""
        return tuple(sorted({*self.values, self.neutral}))

    @property
    def label(self) -> str:
        """Symbol with what a value means."""
        return f"{self.symbol} + [s]" if self.kind == "reversal" else f"{self.symbol} ×"

    def apply(self, drone: Drone, value: float) -> Drone:
        """Return the drone with this value of the change; refuse one that cannot be built.

        A reversing rotor pauses for about ``I^r Ω_min/(k_m I_sat)`` in its dead band, whose edge ``Ω_min``
        is moved to make the pause longer or shorter by `value`.
        """
        if self.kind == "gear":
            gear = dict(drone.gear) | {self.name: drone.value(self.name) * value}
            changed = replace(drone, gear=gear)
            if not changed.value("foot_dz") > changed.value("joint_dz"):
                raise CampaignError(
                    f"{self.symbol} × {value:g}: the feet of {drone.name} lie above the joints of its legs; "
                    "vary it less"
                )
            return changed
        motor = MOTOR.nominal | dict(drone.motor)
        if self.kind == "motor":
            return replace(drone, motor=dict(drone.motor) | {self.name: motor[self.name] * value})
        rate = motor["torque_constant"] * motor["saturation_current"] / motor["rotor_inertia"]
        edge = motor["saturation_speed"] + value * rate
        if not 0.0 < edge < math.inf:
            raise CampaignError(
                f"{REVERSAL} {value:+g} s: the motors of {drone.name} pause for "
                f"{motor['saturation_speed'] / rate:.3g} s when they reverse; take away less, or use ideal "
                "reversal"
            )
        return replace(drone, motor=dict(drone.motor) | {"saturation_speed": edge})


def find_changes(text: str, *, single: bool = False) -> tuple[Change, ...]:
    """Return the changes of a command line, for example ``k_t=0.5:2:5,dx_f=0.8:1.4:4``.

    Each is ``NAME=FIRST:LAST:COUNT``, or ``NAME=VALUE`` where `single` values are asked for. NAME is a row
    of the gear's or the motor's table by name or symbol, its values are factors in equal ratios; or
    ``reversal_delay``, its values are added seconds in equal steps (``0ms:200ms:5``). Raises `CampaignError`
    for anything else, and for a number that is varied twice.
    """
    if not isinstance(text, str):
        raise CampaignError(f"nothing to vary in {text!r:.60}; give a text, for example {_ASKED[single]}")
    changes = tuple(_change(part.strip(), single) for part in text.split(",") if part.strip())
    if not changes:
        raise CampaignError(f"nothing to vary; give for example {_ASKED[single]}")
    names = [change.name for change in changes]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise CampaignError(f"{twice} is varied twice; give it once")
    return changes


def _change(text: str, single: bool) -> Change:
    name, equals, span = text.partition("=")
    name = name.strip()
    rows: list[tuple[Kind, str, str]] = [("gear", row.name, row.symbol) for row in GEAR.values()]
    rows += [("motor", row.name, row.symbol) for row in MOTOR.values()]
    chosen = [row for row in rows if name in row[1:]]
    if name == REVERSAL:
        chosen = [("reversal", REVERSAL, "reversal delay")]
    if not chosen:
        symbols = (row.symbol for row in GEAR.values() if row.symbol.isascii() and "/" not in row.symbol)
        raise CampaignError(
            f"no design parameter {name!r}; known are {REVERSAL}, {', '.join(symbols)}, and every name of "
            "the gear's and the motor's table"
        )
    kind, row_name, symbol = chosen[0]
    parts = [part.strip() for part in span.split(":")]
    if single and equals and len(parts) == 1:
        parts = [*parts, *parts, "1"]
    elif single:
        raise CampaignError(f"{text!r}: expected NAME=VALUE, for example {_ASKED[single]}")
    if not equals or len(parts) != 3 or not parts[2].isdigit() or not 1 <= int(parts[2]) <= _MOST:
        raise CampaignError(
            f"{text!r}: expected NAME=FIRST:LAST:COUNT with a count of 1 to {_MOST}, for example k_t=0.5:2:5"
        )
    unit = "s" if kind == "reversal" else "1"
    first, last = (read_number(part, unit, repr(text)) for part in parts[:2])
    count = int(parts[2])
    if not math.isfinite(first + last):
        raise CampaignError(f"{text!r}: {first:g} to {last:g} are not finite numbers")
    if kind == "reversal":
        return Change(row_name, symbol, kind, tuple(np.linspace(first, last, count).round(12).tolist()))
    if not (first > 0 and last > 0):
        raise CampaignError(f"{text!r}: factors of {first:g} to {last:g}; give numbers above 0")
    # Rounded: the middle of 0.5 to 2 is the set as it is, not 1 + 2e-16.
    return Change(row_name, symbol, kind, tuple(np.geomspace(first, last, count).round(12).tolist()))


class Gain(TypedDict):
    """What a change buys at its best value, and costs at its worst, in landable degrees over the speeds."""

    change: str
    best: list[float]
    gain_deg: float
    worst: list[float]
    loss_deg: float
    steepest_deg: list[float]  # by speed, at the best value
    at_edge: list[bool]  # the same


@dataclass(frozen=True, eq=False)
class DesignStudy:
    """What became of p designs over n slopes and m speeds."""

    name: str  # of the sets
    controller: str  # label of the controller
    changes: tuple[Change, ...]
    settings: StudySettings
    points: FloatArray  # (p, c) value of each change; the first design is the sets as they are
    shares: FloatArray  # (p, 4, n, m) share of the landings by class [1], as from `shares_of`
    lost: IntArray  # (p,) landings that could not be simulated
    outcome: NDArray[np.int8]  # (p, n, m) likeliest class, as of `sysid.landing.maps.LandingMap`
    distance: FloatArray  # (p, n, m) mean over the landings that came to rest [m]; NaN where none did
    time: FloatArray  # (p, n, m) the same [s]

    @property
    def landed(self) -> FloatArray:
        """Share (p, n, m) [1] of the landings that come to rest within the long distance."""
        return np.asarray(self.shares[:, list(LANDED)].sum(axis=1))

    @property
    def steepest(self) -> FloatArray:
        """Slope (p, m) [deg] up to which every one is safe; NaN where not even the first is.

        The grid's last slope is a lower bound, see `at_edge`.
        """
        safe = self.landed >= self.settings.share - 1e-9
        count = np.where(safe.all(axis=1), safe.shape[1], np.argmin(safe, axis=1))
        slopes = np.array([math.nan, *self.settings.slopes_deg])
        return np.asarray(slopes[count])

    @property
    def at_edge(self) -> BoolArray:
        """Whether every slope (p, m) of the grid is safe, so that steeper ones may be, too."""
        return np.asarray(self.steepest == self.settings.slopes_deg[-1])

    @property
    def landable(self) -> FloatArray:
        """Width (p, m) of slopes that the sets land on [deg]: the integral of the share over the slope.

        Equals the steepest slope, to half a step of the grid, where the share falls from 1 to 0 at once. A
        single slope on which the drone falls by chance, with safe ones on both sides, hardly moves it.
        """
        return np.asarray(np.trapezoid(self.landed, np.array(self.settings.slopes_deg), axis=1))

    def along(self, change: int) -> NDArray[np.intp]:
        """Return the numbers (k,) of the designs in which only one change acts, by its value."""
        others = [c for c in range(len(self.changes)) if c != change]
        neutral = np.array([self.changes[c].neutral for c in others])
        alone = np.all(self.points[:, others] == neutral, axis=1)
        chosen = np.flatnonzero(alone)
        _, first = np.unique(self.points[chosen, change], return_index=True)
        return np.asarray(chosen[first])

    def gains(self) -> list[Gain]:
        """Return what each change buys and costs, what buys most first.

        Designs with several changes count as they are. Slopes beyond the grid count nowhere, so a design that
        is safe up to the grid's edge may gain more.
        """
        gained = (self.landable - self.landable[0]).mean(axis=1)
        rows: list[Gain] = []
        groups: list[tuple[tuple[int, ...], NDArray[np.intp]]]
        groups = [((c,), self.along(c)) for c in range(len(self.changes))]
        if self.settings.together:
            groups.append((tuple(range(len(self.changes))), np.arange(len(self.points))))
        for used, chosen in groups:
            if len(chosen) < 2:
                continue
            best, worst = chosen[np.argmax(gained[chosen])], chosen[np.argmin(gained[chosen])]
            rows.append({
                "change": " and ".join(self.changes[c].label for c in used),
                "best": self.points[best, list(used)].tolist(), "gain_deg": float(gained[best]),
                "worst": self.points[worst, list(used)].tolist(), "loss_deg": float(gained[worst]),
                "steepest_deg": self.steepest[best].tolist(), "at_edge": self.at_edge[best].tolist(),
            })  # fmt: skip
        return sorted(rows, key=lambda row: -row["gain_deg"])


def designs(changes: Sequence[Change], together: bool = False) -> FloatArray:
    """Return the values (p, c) [1, s] of designs: the sets as they are, then one change at a time or a grid.

    Raises `CampaignError` for a grid of other than two changes.
    """
    neutral = [change.neutral for change in changes]
    rows = [neutral]
    if together:
        if len(changes) != 2:
            raise CampaignError(f"a map of two changes, but {len(changes)} given; give exactly two to --vary")
        rows += [list(pair) for pair in product(*(change.axis for change in changes))]
    else:
        for c, change in enumerate(changes):
            rows += [[*neutral[:c], value, *neutral[c + 1 :]] for value in change.values]
    unique = list(dict.fromkeys(tuple(row) for row in rows))
    return np.array(unique, dtype=np.float64)


def fleets_of(drones: Sequence[Drone], changes: Sequence[Change], points: FloatArray) -> list[list[Drone]]:
    """Return the drones of every design, a row of `points` (p, c) with a value per change."""
    out = []
    for row in points:
        fleet = list(drones)
        for change, value in zip(changes, row.tolist(), strict=True):
            if value != change.neutral:
                fleet = [change.apply(drone, value) for drone in fleet]
        out.append(fleet)
    return out


def design_study(
    name: str,
    drones: Sequence[Drone],
    changes: Sequence[Change],
    controller: Controller,
    settings: StudySettings | None = None,
    how: Computing | None = None,
) -> DesignStudy | None:
    """Land every design on every slope at every speed; None where the work was stopped.

    `drones` are the sets as they are. `how` is as in `sysid.landing.maps.landing_maps`.
    """
    settings, how = settings or StudySettings(), how or Computing()
    points = designs(changes, settings.together)
    fleets = fleets_of(drones, changes, points)
    attitudes = []
    for number, grid in enumerate(settings.grids(), start=1):
        maps = landing_maps(fleets, [controller], grid, replace(how, part=f"attitude-{number}-"))
        if not maps:
            return None
        attitudes.append(maps)
    # One map holds the landings of a design in all attitudes: an attitude counts like one more parameter set.
    whole = [
        replace(maps[0], **{
            name: np.concatenate([getattr(each, name) for each in maps])
            for name in ("outcome", "distance", "time", "uncertain")
        })
        for maps in zip(*attitudes, strict=True)
    ]  # fmt: skip
    shares, lost = shares_of(np.array([landings.outcome for landings in whole]))
    means = (
        np.array([getattr(landings, name) for landings in whole])
        for name in ("likeliest", "mean_distance", "mean_time")
    )
    return DesignStudy(name, controller.label, tuple(changes), settings, points, shares, lost, *means)


def shares_of(outcome: NDArray[np.int8]) -> tuple[FloatArray, IntArray]:
    """Return the share (p, 4, n, m) [1] of each class of what could be simulated, and the lost (p,) ones.

    From `Outcome` codes (p, S, n, m) of p designs, S sets and attitudes, n slopes and m speeds. The shares
    are 0 where nothing could be simulated: what is not known to be safe is none.
    """
    lost = outcome == Outcome.LOST
    sound = np.maximum(np.sum(~lost, axis=1), 1)
    shares = [np.sum(outcome == each, axis=1) / sound for each in OUTCOMES]
    return np.stack(shares, axis=1), lost.sum(axis=(1, 2, 3))
