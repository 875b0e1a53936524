"""From the drops that a campaign names to what a fit compares: window, initial state, filtered target."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sysid.campaign import GearCampaign, GearTrial
from sysid.campaign.common import TrialUse
from sysid.campaign.file import resolve_log
from sysid.campaign.logs import CaptureLogOptions, load_stated, warn_of_idle_options
from sysid.campaign.swaps import Swap
from sysid.errors import LogError, SysidError
from sysid.filters import KaiserLowpass, Spectrum, amplitude_spectrum, bridge_gaps, differentiate, runs
from sysid.fit.nrmse import CostChannel, TrialTarget
from sysid.gear.model import parameters_on
from sysid.gear.plausible import capture_frame, notice_contradictions, notice_odd_vehicle, notice_slope
from sysid.gear.swaps import swaps, wrong_heights
from sysid.journal import Finding, Journal, hear, note, notice
from sysid.recording import Recording
from sysid.trials.capture import (
    PlanarMotion,
    SpatialMotion,
    held_level,
    marker_plane,
    planar_motion,
    spatial_motion,
)
from sysid.trials.fall import Feet, Flight, find_fall, fit_flight
from sysid.trials.look import inspect_recording
from sysid.types import FloatArray

# Time from the touchdown to the visible end of free fall [s], because the legs yield first: the median of
# synthetic drops on both surfaces, of which single ones have 11 to 21 ms.
_YIELDING = 0.017
# Times before and after the touchdown beyond which the end of free fall points to a wrong surface plane [s].
_EARLY_LATE = (-0.006, 0.035)
# Distance [m] of the surface from where free fall ends from which on a drop is doubted, the largest one that
# leaves no doubt of another campaign, and the difference of two such distances that tells nothing.
_OUT_OF_PLACE, _IN_PLACE, _AS_NEAR = 0.006, 0.012, 0.002
# Time before the touchdown as stated in which a foot of a misstated drop may touch already, and time after
# the hold that shows a fall [s].
_BEFORE, _SHOWS_FALL = 0.15, 0.06
# Keys of the mistakes that a fit can find out.
_HEIGHT, _SLOPES = {"foot_dz"}, {"slope"}
# Shortest fall that tells about g [s]: five samples determine it to some 10 %.
_TELLS_GRAVITY = 0.06
# Largest relative error of the measured g without a doubt [1].
_GRAVITY_DOUBT = 0.15
# Least number of samples in a window.
_LEAST_SAMPLES = 10


@dataclass(frozen=True, eq=False)
class PreparedDrop:
    """One drop, ready to be simulated and compared; `motion` is the whole log, relative to the surface."""

    name: str
    use: TrialUse
    feet: Feet
    motion: PlanarMotion
    flight: Flight
    touchdown: float  # first contact on the log's clock [s]
    impact_speed: float  # downward speed at the touchdown [m/s]
    late: float  # time from the touchdown to the visible end of free fall [s]
    time: FloatArray  # (n,) samples of the window on the log's clock [s]
    initial_state: FloatArray  # (6,) x, z, pitch and rates at time[0] [SI]
    simulated_time: FloatArray  # (n + margin,) samples of the window and of the filter's margin after it [s]
    before: FloatArray  # (margin, 3) x, z, pitch before the window, equal for every candidate
    target: TrialTarget
    # Spectrum of the five channels in the window and its margins before the filter; None without a filter.
    spectrum: Spectrum | None
    # The log, for the judgement of its quality; it stays behind when the drop travels to another process.
    recording: Recording | None
    provenance: dict[str, object]
    # (3, 3) mean rotation before the touchdown, in (x, y, z), from where the body's axes are the capture's.
    attitude: FloatArray
    # Whether pitch counts from the hold, which is level, and not from the capture's axes.
    levelled: bool

    @property
    def slope(self) -> float:
        """Angle of the surface [rad]."""
        return self.feet.slope

    @property
    def surface_error(self) -> float:
        """Height by which the surface seems to lie above the true one [m]."""
        return self.impact_speed * (self.late - _YIELDING)

    @property
    def touches_in_time(self) -> bool:
        """Whether free fall ends where the feet should touch."""
        return _EARLY_LATE[0] < self.late < _EARLY_LATE[1]


def cost_channels(campaign: GearCampaign) -> tuple[CostChannel, ...]:
    """Return the five compared channels with the campaign's weights, as columns of (x, z, q, rates)."""
    weights = campaign.cost.weights
    # If only the log was filtered, the simulation's own rates are compared.
    derived = _same_way(campaign)
    return (
        CostChannel("x_B", "m", 0, weight=weights.x_B),
        CostChannel("z_B", "m", 1, weight=weights.z_B),
        CostChannel("x_B_rate", "m/s", 0 if derived else 3, rate=derived, weight=weights.x_B_rate),
        CostChannel("z_B_rate", "m/s", 1 if derived else 4, rate=derived, weight=weights.z_B_rate),
        CostChannel("q_B", "rad", 2, weight=weights.q_B),
    )


def prepare_drops(
    campaign: GearCampaign, path: str | Path, reaches: Callable[[GearCampaign], bool] = lambda other: False
) -> tuple[PreparedDrop, ...]:
    """Load, project, filter and cut every drop of a campaign, whose logs are named relative to its file.

    A wrong height or two exchanged slopes may keep the feet from touching in time. Then the drops are read
    with another foot_dz, or with the slopes exchanged, if `reaches` says that a fit can start at that
    campaign; the fit finds out what is wrong. By default they are refused, or doubted.

    Raises SysidError for the first drop that cannot be used. A doubtful drop is noticed in the journal: an
    unlikely g, a doubtful touchdown.
    """
    # Every file must exist before the first is read.
    logs = [(trial, resolve_log(path, trial.log)) for trial in campaign.trials]
    capture = campaign.capture

    @cache
    def read_once(log: str, body: str | None, options: str) -> Recording:
        return read_drop_log(campaign, resolve_log(path, log), body, options)

    def read(trial: GearTrial) -> Recording:
        return read_once(trial.log, trial.rigid_body, trial.log_options.model_dump_json())

    warn_of_idle_options(
        "capture",
        {name: value for name, value in capture.loader_options().items() if name != "rigid_body"},
        [(log, trial.log_options.format or capture.format) for trial, log in logs],
    )
    rest = None
    if campaign.surface.rest_log is not None:
        rest = read_once(campaign.surface.rest_log, None, "{}")
    drops: list[PreparedDrop] = []
    doubts: list[Finding] = []
    refusal: LogError | None = None
    for trial in campaign.trials:
        recording = read(trial)
        with Journal() as own:
            try:
                drops.append(_Preparation(campaign, trial, recording, rest).drop())
            except LogError as reason:
                refusal = reason
        doubts += own.findings
        if refusal is not None:
            break
    if refusal is not None:
        # A misstated value of the campaign is the likely cause, so it is named first.
        notice_odd_vehicle(campaign)
        notice_contradictions(campaign, trial, inspect_recording(recording, campaign.vehicle.gravity).drop)
    # Soft legs may delay the visible end of free fall. Nothing ends it before a foot touches.
    early = any(drop.surface_error < -_OUT_OF_PLACE for drop in drops)
    if refusal is not None or early or not all(drop.touches_in_time for drop in drops):
        other = _noticed_swap(campaign, read, rest, reaches)
        if other is not None:
            return tuple(_Preparation(other, trial, read(trial), rest).drop() for trial in other.trials)
    for doubt in doubts:
        hear(doubt)
    if refusal is not None:
        raise refusal
    return tuple(drops)


class _Explained(NamedTuple):
    """A mistake, and how far from the surface free fall ends without it, at worst and in the mean [m]."""

    worst: float
    mean: float
    swap: Swap


def _noticed_swap(
    campaign: GearCampaign,
    read: Callable[[GearTrial], Recording],
    rest: Recording | None,
    reaches: Callable[[GearCampaign], bool],
) -> GearCampaign | None:
    """Notice the mistake without which the feet of every drop touch where free fall ends.

    Return the campaign without that mistake if it is a height, or exchanged slopes, and a fit `reaches` it.
    """

    def error(stated: GearCampaign, k: int) -> float:
        with suppress(SysidError), Journal():
            trial = stated.trials[k]
            return _Preparation(stated, trial, read(trial), rest).drop().surface_error
        return np.inf

    places, found = range(len(campaign.trials)), list[_Explained]()
    before = np.array([abs(error(campaign, k)) for k in places])
    wrong, seen = before > _OUT_OF_PLACE, np.isfinite(before)
    single = np.count_nonzero(wrong) < 2
    for swap in (*swaps(campaign), *wrong_heights()):
        other, after = swap.undone(campaign), before.copy()
        changed = [k for k in places if other.trials[k] != campaign.trials[k]]
        # A single drop does not speak against what all have in common, unless the others say the same.
        if single and not changed and (seen.all() or swap.keys != _HEIGHT):
            continue
        if not np.delete(wrong, changed).any() or not changed:
            for k in changed or places:
                after[k] = abs(error(other, k))
                if after[k] >= _IN_PLACE:
                    break
            worse = single and not changed and after[seen].sum() >= before[seen].sum()
            if not worse and after.max() < min(_IN_PLACE, before.max() - _AS_NEAR):
                found.append(_Explained(float(after.max()), float(after.mean()), swap))
    # One height stands for all: the one with the least mean error.
    heights = sorted((one for one in found if one.swap.keys == _HEIGHT), key=lambda one: one.mean)
    found = sorted((one for one in found if one not in heights[1:]), key=lambda one: one.worst)
    near = [one for one in found if one.worst < found[0].worst + _AS_NEAR]
    if not near:
        return None
    titles = [one.swap.title for one in near]
    others = f" (so do they with {' or '.join(titles[1:])})" if titles[1:] else ""
    sentence = (
        f"all drops touch where free fall ends, within {1000 * near[0].worst:.0f} mm, with "
        f"{titles[0]}{others}: check the campaign"
    )
    for keys, words in ((_HEIGHT, "another height"), (_SLOPES, "the slopes exchanged")):
        for one in near:
            if one.swap.keys == keys and reaches(right := one.swap.undone(campaign)):
                tail = f"; they are read with {words}, and a fit finds out what is wrong"
                notice("contradicts-swapped", sentence + tail)
                return right
    notice("contradicts-swapped", sentence)
    return None


def read_drop_log(campaign: GearCampaign, path: Path, body: str | None, options: str) -> Recording:
    """Read a log with the options of the campaign and of the drop (`options`, JSON: it must be hashable)."""
    of_drop = CaptureLogOptions.model_validate_json(options)
    capture = campaign.capture
    stated = capture.loader_options() | ({} if body is None else {"rigid_body": body})
    recording = load_stated(path, of_drop.format or capture.format, stated, of_drop.loader_options())
    if recording.kind != "motion-capture":
        raise LogError(f"{path}: is a {recording.kind} log, expected motion capture; correct the trial's log")
    return recording


def lowpass_of(campaign: GearCampaign, rate: float) -> KaiserLowpass | None:
    """Return the campaign's filter at a sample rate [Hz]; None where it has none."""
    settings = campaign.filter
    if settings.kind == "none":
        return None
    return KaiserLowpass(rate, settings.cutoff, settings.attenuation_db, settings.transition)


def _same_way(campaign: GearCampaign) -> bool:
    """Return whether simulated samples pass through what the measured ones have passed through."""
    return campaign.filter.kind == "none" or campaign.filter.filter_simulation


def as_compared(coordinates: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the compared channels (n, 5) [SI] of x, z, pitch and rates, as `cost_channels` orders them."""
    return np.column_stack([coordinates[:, :2], rates[:, :2], coordinates[:, 2]])


class _Preparation:
    """One drop between its recording and what is compared."""

    def __init__(
        self, campaign: GearCampaign, trial: GearTrial, recording: Recording, rest: Recording | None
    ) -> None:
        self.campaign, self.trial, self.recording, self.rest = campaign, trial, recording, rest
        self.where = f"{recording.provenance.path}, trial {trial.name!r}"
        capture = campaign.capture
        self.frame = capture_frame(campaign, trial)
        motion = self._spatial(recording, trial.rigid_body or trial.log_options.rigid_body)
        self.notes = [*recording.provenance.notes, *motion.notes]
        slope, point = self._surface()
        self.feet = Feet(campaign.vehicle.foot_dx, campaign.vehicle.foot_dz, slope)
        gravity = campaign.vehicle.gravity
        hold = find_fall(motion, gravity, self.where, trial.release)
        self.levels = levels = hold.stop > hold.start and capture.level == "release"
        # A file's zero is where the body's axes are the capture's.
        level = held_level(motion, hold) if levels else self.frame.axes
        self.motion = planar_motion(motion, point, level)
        flight = partial(fit_flight, self.motion, self.feet, hold, gravity, self.where, levels)
        fitted, self.touchdown = flight()
        held_until = float(self.motion.time[max(hold.stop, 1) - 1])
        end = np.inf
        early = max(self.touchdown - _BEFORE, held_until + _SHOWS_FALL)
        if fitted.held and early < self.touchdown:
            # A surface that is stated too low lets the contact pass for free fall, which shows without it.
            self.flight, _ = flight(end=early)
            late = self._leaves_free_fall() - self.touchdown - _YIELDING
            if late * self.flight.at(np.array([self.touchdown]))[0, 4] > _OUT_OF_PLACE:
                end = self.touchdown + late
                fitted, self.touchdown = flight(end=end)
        self.flight, touchdown = fitted, self.touchdown
        self.touchdown = touchdown if trial.touchdown is None else trial.touchdown
        self.at_touchdown = self.flight.at(np.array([self.touchdown]))[0]
        in_air = slice(hold.start, int(np.searchsorted(motion.time, min(touchdown, end))))
        self.attitude = held_level(motion, in_air) @ self.frame.matrix.T
        self.lowpass = lowpass_of(campaign, self.motion.rate)
        # Samples that filter and difference need on both sides of the window.
        self.margin = (0 if self.lowpass is None else self.lowpass.edge_samples) + 1

    def drop(self) -> PreparedDrop:
        """Return the drop, cut, filtered and judged."""
        motion, flight = self.motion, self.flight
        window = self._window()
        target, spectrum = self._target(window)
        around = self.margin if _same_way(self.campaign) else 0
        initial_state = flight.at(motion.time[window.start : window.start + 1])[0]
        impact_speed = float(-self.at_touchdown[4])
        drop = PreparedDrop(
            name=self.trial.name,
            use=self.trial.use,
            feet=self.feet,
            motion=motion,
            flight=flight,
            touchdown=self.touchdown,
            impact_speed=impact_speed,
            late=self._leaves_free_fall() - self.touchdown,
            time=motion.time[window],
            initial_state=initial_state,
            simulated_time=motion.time[window.start : window.stop + around],
            before=flight.at(motion.time[window.start - around : window.start])[:, :3],
            target=target,
            spectrum=spectrum,
            recording=self.recording,
            provenance={
                **self.recording.provenance.source,
                "rate": motion.rate,
                "slope_deg": float(np.degrees(self.feet.slope)),
                "held_before_release": flight.held,
                "release": flight.start,
                "touchdown": self.touchdown,
                "impact_speed": impact_speed,
                "initial_state": [float(value) for value in initial_state],
                "measured_gravity": flight.measured_gravity,
                "lost_frames_in_window": int(np.sum(~motion.valid[window])),
                "notes": list(map(str, self.notes)),
            },
            attitude=self.attitude,
            levelled=self.levels,
        )
        self._doubt(drop)
        return drop

    def _notice(self, code: str, sentence: str, size: float) -> None:
        notice(code, sentence, trial=self.trial.name, size=size)

    def _spatial(self, recording: Recording, rigid_body: str | None) -> SpatialMotion:
        capture = self.campaign.capture
        return spatial_motion(
            recording, rigid_body or capture.rigid_body, self.frame,
            centre_of_mass_offset=capture.centre_of_mass_offset, rate=capture.rate,
        )  # fmt: skip

    def _surface(self) -> tuple[float, FloatArray]:
        """Return the slope [rad] and a point of the surface in (x, y, z) [m]."""
        surface, trial, frame = self.campaign.surface, self.trial, self.frame
        point = trial.point if trial.point is not None else surface.point
        slope, on_surface = trial.slope, None
        if point is None and surface.markers:
            on_surface, measured, residual = marker_plane(
                self.recording, surface.markers, frame, surface.marker_height, slope
            )
            if measured is not None:
                sentence = f"board markers lie {1000 * residual:.2f} mm rms off their plane"
                self.notes.append(note("board-markers-off-plane", sentence))
                if slope is not None:
                    notice_slope(trial.name, slope, measured)
                slope = measured if slope is None else slope
        if slope is None:
            raise LogError(f"trial {trial.name!r}: no slope; give it")
        if on_surface is not None:
            return slope, on_surface
        if point is not None:
            return slope, frame.matrix @ np.asarray(point)
        assert self.rest is not None  # the campaign was validated: one of three ways is there
        motion = self._spatial(self.rest, None)
        centre = np.median(motion.position[motion.valid], axis=0)
        # At rest the body sinks on its nominal legs: axial, bending and ground compliance in series [m/N].
        vehicle = self.campaign.vehicle
        value = parameters_on(surface.law, vehicle.model_dump(exclude_none=True)).nominal
        compliance = 1 / value["leg_axial_stiffness"]
        compliance += (vehicle.foot_dx - value["joint_dx"]) ** 2 / value["leg_bending_stiffness"]
        compliance += 1 / value["ground_stiffness"]
        depth = vehicle.foot_dz - 0.5 * vehicle.body_mass * vehicle.gravity * compliance
        return slope, centre - depth * np.array([np.sin(slope), 0.0, np.cos(slope)])

    def _window(self) -> slice:
        """Return the compared samples, from just before contact to the end of window, board or log."""
        settings, time, margin = self.campaign.window, self.motion.time, self.margin
        start_time = self.touchdown - settings.before_contact
        if self.flight.held:
            start_time = max(start_time, self.flight.start)
        first = int(np.searchsorted(time, start_time - 1e-9))
        last = int(np.searchsorted(time, self.touchdown + settings.after_contact + 1e-9))
        off_board = self._off_board(last)
        if off_board is not None:
            last = off_board
            sentence = f"the body leaves the board {time[last] - self.touchdown:.2f} s after touchdown"
            self.notes.append(note("leaves-board", sentence))
        if first - margin < 0:
            raise LogError(
                f"{self.where}: the window starts {first} samples into the log, the filter needs {margin} "
                "before it; start recording earlier"
            )
        ends_early = last + margin > len(time)
        if ends_early:
            last = max(0, len(time) - margin)
        if last - first < _LEAST_SAMPLES or time[min(last, len(time)) - 1] < self.touchdown:
            raise LogError(
                f"{self.where}: only {max(0, last - first)} samples are left in the window around the "
                f"touchdown at {self.touchdown:.3f} s; record longer (the filter needs {margin} samples "
                "after the window)"
            )
        if ends_early:
            kept = float(time[last - 1] - self.touchdown)
            sentence = f"the log ends early: the window ends {kept:.2f} s after the touchdown"
            self.notes.append(note("log-ends-early", sentence))
            self._notice(
                "log-ends-early",
                f"the log ends early: its window ends {kept:.2f} s after the touchdown instead of "
                f"{settings.after_contact:.2g} s (the filter needs {margin} samples more); the drop counts "
                "as much as the others",
                settings.after_contact - kept,
            )
        lost = runs(~self.motion.valid[first - margin : last + margin])
        begin, end = max(lost, key=lambda run: run[1] - run[0], default=(0, 0))
        gap = (end - begin) / self.motion.rate
        if gap > settings.max_gap + 1e-9:
            raise LogError(
                f"{self.where}: the body is lost for {1000 * gap:.0f} ms from "
                f"{time[first - margin + begin]:.3f} s, longer than window.max_gap "
                f"({1000 * settings.max_gap:.0f} ms); record the drop again or shorten the window"
            )
        return slice(first, last)

    def _off_board(self, last: int) -> int | None:
        """Return the first sample before `last` at which the body is off the board; None if it stays."""
        motion, board = self.motion, self.campaign.surface.board_length
        if board is None:
            return None
        along = np.column_stack([motion.x, motion.z]) @ self.feet.tangent
        at_touchdown = int(np.clip(np.searchsorted(motion.time, self.touchdown), 0, len(along) - 1))
        origin = along[at_touchdown]
        if not np.isfinite(origin):
            origin = float(self.at_touchdown[:2] @ self.feet.tangent)
        left = np.flatnonzero(along[at_touchdown:last] - origin > board)
        return at_touchdown + int(left[0]) if len(left) else None

    def _target(self, window: slice) -> tuple[TrialTarget, Spectrum | None]:
        """Return the filtered and differentiated window, and its spectrum before the filter."""
        margin, rate, lowpass = self.margin, self.motion.rate, self.lowpass
        wide = slice(window.start - margin, window.stop + margin)
        seen = self.motion.valid[wide]
        filled = bridge_gaps(self.motion.coordinates()[wide], seen)
        smooth = filled if lowpass is None else lowpass.apply(filled)
        raw = as_compared(filled, differentiate(filled, rate))[1:-1]
        same_way = _same_way(self.campaign)
        target = TrialTarget(
            name=self.trial.name,
            measured=as_compared(smooth, differentiate(smooth, rate))[margin:-margin],
            valid=seen[margin:-margin],
            rate=rate,
            taps=lowpass.taps if lowpass is not None and same_way else None,
            delivered=seen if same_way else None,
        )
        return target, None if lowpass is None else amplitude_spectrum(raw, rate)

    def _doubt(self, drop: PreparedDrop) -> None:
        """Notice an unlikely g and a doubtful touchdown."""
        measured, gravity = self.flight.measured_gravity, self.campaign.vehicle.gravity
        wrong = abs(measured / gravity - 1)
        # False of an unknown g, NaN.
        if self.touchdown - self.flight.start > _TELLS_GRAVITY and wrong > _GRAVITY_DOUBT:
            self._notice(
                "unlikely-gravity",
                f"the fall shows {measured:.1f} m/s² instead of {gravity:.2f}; check the length unit, "
                "capture.up, the slope and that nothing brakes the body",
                wrong,
            )
        if not drop.touches_in_time:
            side, level = ("after", "high") if drop.late > 0 else ("before", "low")
            self._notice(
                "doubtful-surface",
                f"the body leaves free fall {1000 * abs(drop.late):.0f} ms {side} the feet should touch; the "
                f"surface plane may lie about {1000 * abs(drop.surface_error):.0f} mm too {level}; check the "
                "slope and the plane",
                abs(drop.late),
            )

    def _leaves_free_fall(self) -> float:
        """Return when the height or pitch first leaves the flight model for good [s]."""
        motion, flight = self.motion, self.flight
        near = (motion.time > self.touchdown - _BEFORE) & (motion.time < self.touchdown + 0.1) & motion.valid
        error = np.abs(motion.coordinates()[near] - flight.at(motion.time[near])[:, :3])
        limit = np.maximum(6 * flight.noise, [np.inf, 1e-3, 0.01])
        away = np.asarray((error[:, 1:] > limit[1:]).any(axis=1))
        inside = np.flatnonzero(~away)
        later = motion.time[near][inside[-1] + 1 :] if len(inside) else motion.time[near]
        return float(later[0]) if len(later) else float("inf")
