"""Descriptions of drops: the quality of their logs, what they excite, their contacts and resting places.

A start that noise has moved by a tenth of a millimetre ends elsewhere after five bounces, so one simulated
resting place proves nothing. The spread over draws of the fit and of the start says what can be known.
"""

from collections.abc import Mapping, Sequence
from typing import Unpack

import numpy as np
from scipy import signal

from sysid.campaign import GearCampaign
from sysid.filters import bridge_gaps, runs
from sysid.fit.result import FitResult
from sysid.fit.story import Read, ReadTrial, Story
from sysid.gear.drops import PreparedDrop, lowpass_of
from sysid.gear.model import (
    LF_FREE,
    PARAMETERS,
    Drops,
    Ending,
    EventKind,
    Simulation,
    find_surface,
    simulate,
    simulate_population,
)
from sysid.gear.out_of_plane import tell_limits
from sysid.gear.plausible import notice_contradictions, notice_odd_vehicle
from sysid.gear.problem import CONSTANTS, NEVER_IN_DROPS, ONE_TOUCHDOWN, GearProblem, read_by_laws
from sysid.gear.starts import start_roots
from sysid.gear.stated import CENTRE, RELEASE, SURFACE, TILT, Moved
from sysid.journal import notice, tell
from sysid.parameters import ParameterTable
from sysid.trials.look import inspect_recording, log_quality
from sysid.types import FloatArray, IntArray

# The rules of rest.
_REST = Ending()
# Time over which rates of the measurement are taken [s]: differences of single samples are noise.
_SMOOTH = 0.11
# Longest time after the touchdown that is looked at [s].
_LONGEST = 5.0
_AT_REST, _FAILED = "at rest", "simulation failed"
# Time that simulations go on beyond a log [s].
_BEYOND = 1.0
# Least number of samples of a flight phase that shows the centre of mass.
_LEAST_FLIGHT = 8
# Least height of the feet in a flight phase [m].
_CLEAR = 4e-3
# Least number of standard errors, and least length [m], of an offset that is noticed.
_SURE, _FAR = 4.0, 3e-3

FlightPhase = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class GearStory(Story[GearProblem]):
    """Descriptions of the drops of a problem."""

    @property
    def keys(self) -> Mapping[str, str]:
        """Offsets and places by the key that states them."""
        surface = self.problem.campaign.surface
        place = "marker_height" if surface.markers else "rest_log" if surface.rest_log else "point"
        keys = dict.fromkeys((row.name for row in CENTRE), "centre_of_mass_offset")
        keys |= dict.fromkeys((row.name for row in SURFACE), place)
        own = [trial.name for trial in self.problem.campaign.trials if trial.point is not None]
        keys |= {row.of_trial(name).name: "point" for row in SURFACE for name in own}
        return {RELEASE.name: "release", TILT.name: "tilt", **keys}

    def tell_stated(self) -> None:
        """Tell also what is not used, and what is exact because the drops slide along several directions."""
        notice_defaults(self.problem)
        super().tell_stated()
        campaign = self.problem.campaign
        fitted = (trial for trial in campaign.trials if trial.use == "fit")
        ways = {trial.down_slope or campaign.capture.down_slope for trial in fitted}
        if len(ways) > 1 and not campaign.fit.exact:
            tell(
                f"the drops slide along {', '.join(sorted(ways))}: centre_of_mass_offset, tilt and "
                "surface.point are taken as exact; drops along one direction would fit them"
            )

    @property
    def accuracy(self) -> Mapping[str, object]:
        """The law and the tolerance."""
        law = self.problem.campaign.surface.law
        return {"friction_law": law, "accuracy_of_a_simulation": self.problem.tolerance}

    @property
    def filters(self) -> Mapping[str, object]:
        """The low-pass at the rate of the first drop."""
        lowpass = lowpass_of(self.problem.campaign, self.problem.drops[0].motion.rate)
        if lowpass is None:
            return {"kind": "none"}
        return lowpass.design() | {"simulation_filtered": self.problem.campaign.filter.filter_simulation}

    def read(self, fit: FitResult, values: FloatArray) -> list[ReadTrial]:
        """Return where and when every drop rests, its largest pitch, its touchdowns, and how it ends.

        Slope and release of a drop that was not fitted have the errors that the campaign states of them.
        """
        own = self.problem.with_rows_of_all
        board, rows = own.campaign.surface.board_length, self.drawn(fit, values)
        table, how = own.space.table, own.simulation
        return [read_drop(drop, table, rows, board, **how) for drop in own.drops]

    def quality(self) -> list[dict[str, object]]:
        """Return how good every log is, and how its fall begins and ends."""
        campaign, out = self.problem.campaign, []
        notice_odd_vehicle(campaign)
        trials = {trial.name: trial for trial in campaign.trials}
        for drop in self.problem.drops:
            assert drop.recording is not None
            flight, motion = drop.flight, drop.motion
            report = inspect_recording(drop.recording, campaign.vehicle.gravity)
            notice_contradictions(campaign, trials[drop.name], report.drop)
            window = (motion.time >= drop.time[0]) & (motion.time <= drop.time[-1])
            tilt = np.nanmax(np.abs([motion.roll[window], motion.yaw[window]]))
            # Error of the g of a parabola through n samples of noise σ over a time T: σ sqrt(720/n)/T².
            fall = drop.touchdown - flight.start
            count = fall * motion.rate
            error = float(flight.noise[1] * np.sqrt(720.0 / count) / fall**2) if count > 3 else np.nan
            stated = ("slope_deg", "release", "touchdown", "impact_speed", "notes")
            out.append({
                **log_quality(drop.name, drop.use, report),
                **{key: drop.provenance[key] for key in stated},
                "noise": dict(zip(("x", "z", "pitch"), flight.noise.tolist(), strict=True)),
                "gravity": flight.measured_gravity,
                "gravity_error": error,
                "held": flight.held,
                "lost_in_window": int(np.sum(~motion.valid[window])),
                "out_of_plane_deg": float(np.degrees(tilt)),
            })  # fmt: skip
        return out

    def excitation(self) -> dict[str, object]:
        """Return the ranges of slopes [deg], impact speeds [m/s] and largest pitch rates [rad/s]."""
        drops = self.problem.fitted.drops
        rates = [np.gradient(drop.target.measured[:, 4], 1 / drop.motion.rate) for drop in drops]
        spans = {
            "slope_deg": [float(np.degrees(drop.slope)) for drop in drops],
            "impact_speed": [drop.impact_speed for drop in drops],
            "pitch_rate": [float(np.nanmax(np.abs(rate))) for rate in rates],
        }
        return {name: [min(values), max(values)] for name, values in spans.items()}

    def about(self) -> dict[str, object]:
        """Return where the centre of mass is, seen from the stated one; tell how straight drops must fall."""
        tell_limits(self.problem)
        return {"centre_of_mass": centre_of_mass(self.problem.drops, self.problem.campaign)}

    def contacts(self, trial: int, row: FloatArray) -> FloatArray:
        """Return when feet touch (k,) [s] in a prediction, on the drop's clock; within 5 ms: once."""
        drop = self.problem.drops[trial]
        run = simulate(
            row[: len(PARAMETERS)], drop.slope, drop.initial_state, drop.simulated_time,
            surface=self.problem.campaign.surface.law, tolerance=self.problem.tolerance,
        )  # fmt: skip
        out: list[float] = []
        last: dict[str, float] = {}
        for event in run.events:
            if event.kind is EventKind.TOUCHDOWN:
                if event.time - last.get(event.foot, -1.0) > ONE_TOUCHDOWN:
                    out.append(event.time)
                last[event.foot] = event.time
        return drop.time[0] + np.array(out)


def read_drop(
    drop: PreparedDrop,
    table: ParameterTable,
    rows: FloatArray,
    board_length: float | None,
    **simulation: Unpack[Simulation],
) -> ReadTrial:
    """Return numbers of use of a drop and of its simulations by rows (n, n_table) [SI], best set first.

    All but the best set's start within the noise that measured their start, and are seen with the capture's
    noise. `board_length` counts down-slope from the first touchdown [m]. Place and time of rest count from
    there as well.
    """
    motion, random = drop.motion, np.random.default_rng(0)
    chosen = (motion.time >= drop.time[0]) & (motion.time <= drop.touchdown + _LONGEST)
    clock = motion.time[chosen]
    # Rest is seen once it has lasted: simulations go on beyond the log.
    longer = np.concatenate([clock, clock[-1] + np.arange(1, int(_BEYOND * motion.rate)) / motion.rate])
    normal = random.standard_normal((len(rows), 6))
    normal[0] = 0.0
    moved = Moved.of(table, rows, (drop,))
    captured = np.repeat(drop.initial_state[None, None], len(rows), axis=0)
    captured = captured if moved is None else moved.released((drop,))
    captured = captured + (normal @ start_roots(drop))[:, None]
    jobs = Drops(np.array([drop.slope]), drop.initial_state[None], (longer,))
    flown = simulate_population(
        rows[:, : len(PARAMETERS)], jobs, body_states=captured if moved is None else moved.starts(captured),
        slopes=None if moved is None else moved.slopes, **simulation,
    )  # fmt: skip
    samples = flown.samples
    if moved is not None:
        moved.as_captured(samples, 0)
    tracks = samples[:, :, :3]
    tracks[1:] += random.standard_normal(tracks[1:].shape) * drop.flight.noise
    tracks[flown.status[:, 0] != 0] = np.nan
    measured = bridge_gaps(motion.coordinates(), motion.valid)[None, chosen]
    seen = _read(drop, clock, measured, clock[-1], board_length)
    if seen.ends == [_FAILED]:
        # The capture lost the body before its log ends, so nothing is known of where it went.
        return ReadTrial([])
    # A simulation that rests too late for the log to show it ends as the measurement does: moving.
    late = 0.0 if seen.ends == [_AT_REST] else _REST.rest_time
    parts = [seen, _read(drop, longer, tracks, clock[-1], board_length, late)]
    numbers = [
        Read(one.what, one.unit, np.concatenate([one.values, other.values]))
        for one, other in zip(parts[0].numbers, parts[1].numbers, strict=True)
    ]
    # The first touchdown is where the simulations begin.
    known = min(
        (each for each in numbers if "first" in each.what),
        key=lambda each: np.nan_to_num(each.values[0], nan=np.inf),
    )
    ends = [end for part in parts for end in part.ends or ()]
    return ReadTrial([each for each in numbers if each is not known], ends)


def _read(
    drop: PreparedDrop,
    clock: FloatArray,
    tracks: FloatArray,
    log_end: float,
    board_length: float | None,
    late: float = 0.0,
) -> ReadTrial:
    """Return the numbers of tracks (n, samples, 3) of x, z, pitch [m, m, rad], all read alike.

    A body that rests from `late` before the end of the log on counts as moving [s].
    """
    since, last = clock - drop.touchdown, len(clock) - 1
    lost = np.asarray(~np.isfinite(tracks).all(axis=(1, 2)))
    tracks = np.where(lost[:, None, None], 0.0, tracks)
    touch = float(drop.flight.at(np.array([drop.touchdown]))[0, :2] @ drop.feet.tangent)
    width = min(2 * int(_SMOOTH * drop.motion.rate / 2) + 1, last + 1 - last % 2)
    smooth, rates = (
        signal.savgol_filter(tracks, width, 2, deriv=order, delta=1 / drop.motion.rate, axis=1)
        for order in (0, 1)
    )
    along = smooth[:, :, :2] @ drop.feet.tangent - touch
    still = np.hypot(rates[:, :, 0], rates[:, :, 1]) < _REST.rest_speed
    still &= (np.abs(rates[:, :, 2]) < _REST.rest_turn) & (since > 0)
    gone = along > (np.inf if board_length is None else board_length)
    leans = np.abs(tracks[:, :, 2] - drop.slope) > _REST.flip_angle
    # The first sample after which a body stays slow for the time of rest.
    lasting = max(1, round(_REST.rest_time * drop.motion.rate))
    slow = np.cumsum(np.pad(still, ((0, 0), (1, 0))), axis=1, dtype=np.int64)
    rest = np.zeros_like(still)
    rest[:, : max(0, last + 2 - lasting)] = slow[:, lasting:] - slow[:, :-lasting] == lasting
    within = clock <= log_end + 1e-9
    end = np.where(gone.any(axis=1), np.argmax(gone, axis=1), last)
    first = np.argmax(rest, axis=1)
    rests = rest.any(axis=1) & (first <= end)
    at = np.where(rests, first, end)
    each, nan = np.arange(len(tracks)), np.where(rests, 1.0, np.nan)
    until = (np.arange(last + 1) <= at[:, None]) & (since > 0) & within
    numbers = [
        Read("rest place", "cm", 100 * along[each, at] * nan),
        Read("time to rest", "ms", 1000 * since[at] * nan),
        Read("largest pitch", "deg", np.degrees(np.max(np.where(until, np.abs(tracks[:, :, 2]), 0), axis=1))),
    ]
    clear = drop.feet.clearances(*np.moveaxis(tracks, 2, 0))
    for foot, name in enumerate(("rear foot", "front foot")):
        landed, height = None, clear[:, :, foot]
        for nth in ("first", "second"):
            landed = _touchdown(height, landed)
            numbers.append(
                Read(f"touchdown, {nth} of the {name}", "ms", 1000 * _crossing(since, height, landed))
            )
    numbers = [Read(what, unit, np.where(lost, np.nan, values)) for what, unit, values in numbers]
    cases = [
        lost,
        (leans & within).any(axis=1),
        (gone & within).any(axis=1),
        rests & (clock[at] <= log_end - late),
    ]
    words = [_FAILED, "flipped", "left the board", _AT_REST]
    return ReadTrial(numbers, np.select(cases, words, "still moving").tolist())


def _touchdown(height: FloatArray, before: IntArray | None) -> IntArray:
    """Return at which sample (n,) a foot comes down to the surface, once it was clear of it; -1: never.

    `height` (n, samples) is of the foot with its leg unloaded [m]; `before` an earlier touchdown (n,).
    """
    index = np.arange(height.shape[1])
    free = (height > _CLEAR) & (index > (-1 if before is None else before[:, None]))
    cleared = np.where(free.any(axis=1), np.argmax(free, axis=1), height.shape[1])
    down = (height <= 0) & (index > cleared[:, None])
    known = down.any(axis=1) & (True if before is None else before >= 0)
    return np.where(known, np.argmax(down, axis=1), -1)


def _crossing(time: FloatArray, height: FloatArray, landed: IntArray) -> FloatArray:
    """Return when (n,) [s] heights (n, samples) pass zero between a touchdown's sample and the one before."""
    after = np.maximum(landed, 1)
    each = np.arange(len(height))
    high, low = height[each, after - 1], height[each, after]
    share = high / np.maximum(high - low, 1e-12)
    return np.where(landed > 0, time[after - 1] + share * (time[after] - time[after - 1]), np.nan)


def centre_of_mass(drops: tuple[PreparedDrop, ...], campaign: GearCampaign) -> dict[str, float] | None:
    """Return the point about which the body turns in flight, seen from the stated centre of mass [m].

    Down-slope and up in the body while it hangs level, with errors; an offset that is sure is noticed. None
    where the body flew too little after a contact. Flights of some 50 ms determine the point to centimetres
    only: they mostly show the velocity at their start. Legs with a mass swing on after a contact and take the
    body off its parabola: such a model makes no offset sure.
    """
    flights: list[FlightPhase] = []
    for drop in drops:
        motion = drop.motion
        inside = (motion.time > drop.touchdown + 0.02) & (motion.time < drop.time[-1]) & motion.valid
        clear = drop.feet.clearances(motion.x, motion.z, motion.pitch).min(axis=1)
        free = inside & (np.nan_to_num(clear, nan=-1.0) > _CLEAR)
        tracks = (motion.time, motion.x, motion.z, motion.pitch)
        for first, last in runs(free):
            if last - first >= _LEAST_FLIGHT:
                time, x, z, pitch = (track[first:last] for track in tracks)
                flights.append((time, x, z, pitch))
    noise = max(float(np.max(drop.flight.noise[:2])) for drop in drops)
    if sum(len(part[0]) for part in flights) < 4 * _LEAST_FLIGHT:
        return None
    offset, error = turning_point(flights, campaign.vehicle.gravity, noise)
    massless = "leg_mass" not in find_surface(campaign.surface.law).free
    for name, value, sigma in zip(("down-slope", "up"), offset, error, strict=True):
        if massless and abs(value) > max(_SURE * sigma, _FAR):
            notice(
                "centre-of-mass-off",
                f"in free flight the body turns about a point {1000 * value:.1f} ± {1000 * sigma:.1f} mm off "
                f"the stated centre of mass ({name}); check capture.centre_of_mass_offset and the slope",
            )
    return {
        "down_slope": float(offset[0]), "down_slope_error": float(error[0]),
        "up": float(offset[1]), "up_error": float(error[1]),
    }  # fmt: skip


def turning_point(
    flights: Sequence[FlightPhase], gravity: float, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return where in the body the point lies that moves on parabolas (2,), and the standard errors (2,) [m].

    Flights are (time, x, z, pitch) of a point of the body [s, m, m, rad], whose positions have a noise [m].

    Notes
    -----
    A point at d from the centre of mass moves as ``c(t) + d_x ex(q) + d_z ez(q)``; c is linear in time but
    for the fall. What is linear in time is taken out of both sides first. The result points from the tracked
    point to the centre of mass.
    """
    rows, values = [], []
    for time, x, z, q in flights:
        since = time - time.mean()
        basis, _ = np.linalg.qr(np.vander(since, 2, increasing=True))
        for track, columns in (
            (x, np.column_stack([np.cos(q), np.sin(q)])),
            (z + gravity * since**2 / 2, np.column_stack([-np.sin(q), np.cos(q)])),
        ):
            both = np.column_stack([columns, track])
            left = both - basis @ (basis.T @ both)
            rows.append(left[:, :2])
            values.append(left[:, 2])
    design, target = np.concatenate(rows), np.concatenate(values)
    offset, *_ = np.linalg.lstsq(design, target, rcond=None)
    rest = float(np.sqrt(np.mean((target - design @ offset) ** 2)))
    error = max(noise, rest) * np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))
    return -offset, np.asarray(error)


def notice_defaults(problem: GearProblem) -> None:
    """Name stated values that are not used, and values of the paper's drone that stand in for others."""
    law, stated = problem.campaign.surface.law, problem.stated
    for name in (row.name for row in problem.space.found):
        if name in stated:
            notice(
                "stated-and-free",
                f"{name} is stated in the campaign and free on {law}: the search chooses it, the stated "
                "value is not used; name it under [parameters.fixed] to keep it",
            )
    reads = find_surface(law).reads
    given = {*stated, *problem.campaign.parameters.fixed, *CONSTANTS, *LF_FREE}
    left = [] if "law" in problem.campaign.surface.model_fields_set else [f"law {law}"]
    left += [
        f"{name} {value:.4g} {PARAMETERS[name].unit}".removesuffix(" 1")
        for name, value in problem.space.fixed.items()
        if name in PARAMETERS
        and name not in {*given, *NEVER_IN_DROPS}
        and (name in reads or name not in read_by_laws())
    ]
    if left:
        notice(
            "values-of-the-paper",
            f"not in the campaign, so the values of the paper's F450, scaled to this vehicle, are used: "
            f"{', '.join(left)}; state your own",
        )
    for name in {*NEVER_IN_DROPS} - given:
        value = f"{problem.space.fixed[name]:.4g} {PARAMETERS[name].unit}"
        tell(f"{name}: {value}, the paper's scaled to the feet; no drop depends on it, maps and exports do")
