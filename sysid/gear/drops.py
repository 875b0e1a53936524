"""From the drops that a campaign names to what a fit compares: window, initial state, filtered target."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign, GearTrial
from sysid.campaign.file import resolve_log
from sysid.campaign.logs import CaptureLogOptions
from sysid.campaign.read_logs import load_stated, warn_of_idle_options
from sysid.errors import LogError
from sysid.filters import KaiserLowpass, Spectrum, amplitude_spectrum, bridge_gaps, differentiate, runs
from sysid.fit.nrmse import CostChannel, TrialTarget
from sysid.gear.parameters import parameters_on
from sysid.journal import notice
from sysid.recording import Recording
from sysid.trials.capture import (
    PLANAR_LIMIT,
    CaptureFrame,
    PlanarMotion,
    SpatialMotion,
    held_level,
    marker_plane,
    planar_motion,
    spatial_motion,
)
from sysid.trials.fall import Feet, Flight, SlopedPlane, find_fall, fit_flight
from sysid.types import FloatArray

# A body leaves free fall visibly some 10 ms after the feet touch, because its legs yield first. Leaving it
# `_EARLY` before or `_LATE` after the touchdown points to a wrong surface plane [s].
_EARLY, _LATE, _YIELDING = 0.006, 0.035, 0.01
# The slopes that board markers and campaign state may differ by this much without a warning.
_SLOPE_DOUBT = np.radians(1.0)
# Five samples of fall tell g to some 10 %: of a fall shorter than this [s] g says little.
_TELLS_GRAVITY, _GRAVITY_DOUBT = 0.06, 0.15
# The least number of samples in a window.
_LEAST_SAMPLES = 10


@dataclass(frozen=True, eq=False)
class PreparedDrop:
    """One drop, ready to be simulated and compared.

    Parameters
    ----------
    name, use, slope
        As in the campaign; slope [rad].
    motion, flight
        The whole log, relative to a point of the surface; hold and fall before contact.
    touchdown, impact_speed : float
        First contact on the log's clock [s], and the downward speed there [m/s].
    time : (n,) array
        Sample times of the window on the log's clock [s].
    initial_state : (6,) array
        x, z, pitch and rates at time[0] [SI].
    simulated_time : (n + margin,) array
        Samples that a simulation must give: the window and the filter's margin after it [s].
    before : (margin, 3) array
        x, z, pitch at the samples before the window, equal for every candidate.
    target : TrialTarget
        What the cost compares with.
    spectrum : Spectrum or None
        Of the five channels in the window and its margins before the filter; None without a filter.
    provenance : dict
        Log file, hash, loader, what was noticed.
    """

    name: str
    use: str
    slope: float
    motion: PlanarMotion
    flight: Flight
    touchdown: float
    impact_speed: float
    time: FloatArray
    initial_state: FloatArray
    simulated_time: FloatArray
    before: FloatArray
    target: TrialTarget
    spectrum: Spectrum | None
    provenance: dict[str, Any]


def cost_channels(campaign: GearCampaign) -> tuple[CostChannel, ...]:
    """Return the five compared channels with the campaign's weights, as columns of (x, z, q, rates)."""
    weights = campaign.cost.weights
    # An unfiltered simulation gives its rates itself; a filtered one is differentiated as the log was.
    derived = campaign.filter.kind == "none" or campaign.filter.filter_simulation
    return (
        CostChannel("x_B", "m", 0, weight=weights.x_B),
        CostChannel("z_B", "m", 1, weight=weights.z_B),
        CostChannel("x_B_rate", "m/s", 0 if derived else 3, rate=derived, weight=weights.x_B_rate),
        CostChannel("z_B_rate", "m/s", 1 if derived else 4, rate=derived, weight=weights.z_B_rate),
        CostChannel("q_B", "rad", 2, weight=weights.q_B),
    )


def prepare_drops(campaign: GearCampaign, path: str | Path) -> tuple[PreparedDrop, ...]:
    """Load, project, filter and cut every drop of a campaign, whose logs are named relative to its file.

    Raises SysidError for the first drop that cannot be used. A doubtful drop is noticed in the journal:
    rotation out of the plane, an unlikely g, a doubtful touchdown.
    """
    # Several drops may lie in one long take: keep the last files read.
    read = lru_cache(maxsize=2)(partial(read_drop_log, campaign))

    for trial in campaign.trials:  # every file must exist before the first is read
        resolve_log(path, trial.log)
    capture = campaign.capture
    warn_of_idle_options(
        "capture",
        {name: value for name, value in capture.loader_options().items() if name != "rigid_body"},
        [(resolve_log(path, t.log), t.log_options.format or capture.format) for t in campaign.trials],
    )
    rest = None
    if campaign.surface.rest_log is not None:
        rest = read(resolve_log(path, campaign.surface.rest_log), None, "{}")
    return tuple(
        _prepare(
            campaign,
            trial,
            read(resolve_log(path, trial.log), trial.rigid_body, trial.log_options.model_dump_json()),
            rest,
        )
        for trial in campaign.trials
    )


def read_drop_log(campaign: GearCampaign, path: Path, body: str | None, options: str) -> Recording:
    """Read a log with the options of the campaign and of the drop (`options`, JSON: it must be hashable)."""
    of_drop = CaptureLogOptions.model_validate_json(options)
    capture = campaign.capture
    stated = capture.loader_options() | ({} if body is None else {"rigid_body": body})
    recording = load_stated(path, of_drop.format or capture.format, stated, of_drop.loader_options())
    if recording.kind != "motion-capture":
        raise LogError(f"{path}: is a {recording.kind} log, expected motion capture; correct the trial's log")
    return recording


def _prepare(
    campaign: GearCampaign, trial: GearTrial, recording: Recording, rest: Recording | None
) -> PreparedDrop:
    origin = recording.provenance
    where = f"{origin.path}, trial {trial.name!r}"
    frame = CaptureFrame(campaign.capture.up, trial.down_slope or campaign.capture.down_slope)
    motion = _motion(campaign, trial, recording, frame)
    notes = [*origin.sentences, *motion.notes]
    slope, point = _surface(campaign, trial, recording, rest, frame, notes)
    plane, feet = SlopedPlane(slope), Feet(campaign.vehicle.foot_dx, campaign.vehicle.foot_dz)
    gravity = campaign.vehicle.gravity

    held = find_fall(motion, gravity, where, trial.release)
    levels = held.stop > held.start and campaign.capture.level == "release"
    level = held_level(motion, held) if levels else np.eye(3)
    planar = planar_motion(motion, point, level)
    flight, touchdown = fit_flight(planar, plane, feet, held, gravity, where, levels)
    if trial.touchdown is not None:
        touchdown = trial.touchdown

    lowpass = None
    if campaign.filter.kind == "kaiser":
        settings = campaign.filter
        lowpass = KaiserLowpass(planar.rate, settings.cutoff, settings.attenuation_db, settings.transition)
    margin = (0 if lowpass is None else lowpass.edge_samples) + 1
    window = _window(campaign, trial, planar, plane, flight, touchdown, margin, where, notes)
    target, spectrum, before_time, after = _target(campaign, trial, planar, window, lowpass, margin)
    initial_state = flight.at(planar.time[window.start : window.start + 1])[0]
    impact_speed = float(-flight.at(np.array([touchdown]))[0, 4])
    _doubts(trial, planar, window, flight, touchdown, gravity)
    return PreparedDrop(
        name=trial.name,
        use=trial.use,
        slope=slope,
        motion=planar,
        flight=flight,
        touchdown=touchdown,
        impact_speed=impact_speed,
        time=planar.time[window],
        initial_state=initial_state,
        simulated_time=planar.time[window.start : window.stop + after],
        before=flight.at(before_time)[:, :3],
        target=target,
        spectrum=spectrum,
        provenance={
            "log": Path(origin.path).name,
            "sha256": origin.sha256,
            "format": origin.format,
            "device": origin.device,
            "rate [Hz]": planar.rate,
            "slope [deg]": float(np.degrees(slope)),
            "held before release": flight.held,
            "release [s]": flight.start,
            "touchdown [s]": touchdown,
            "impact speed [m/s]": impact_speed,
            "initial_state": [float(value) for value in initial_state],
            "free-fall g [m/s²]": flight.measured_gravity,
            "lost frames in window": int(np.sum(~planar.valid[window])),
            "notes": notes,
        },
    )


def _motion(
    campaign: GearCampaign, trial: GearTrial | None, recording: Recording, frame: CaptureFrame
) -> SpatialMotion:
    capture = campaign.capture
    stated = (trial.rigid_body or trial.log_options.rigid_body) if trial is not None else None
    return spatial_motion(
        recording, stated or capture.rigid_body, frame,
        centre_of_mass_offset=capture.centre_of_mass_offset, rate=capture.rate,
    )  # fmt: skip


def _surface(
    campaign: GearCampaign,
    trial: GearTrial,
    recording: Recording,
    rest: Recording | None,
    frame: CaptureFrame,
    notes: list[str],
) -> tuple[float, FloatArray]:
    """Return the slope [rad] and a point of the surface in (x, y, z) [m]."""
    surface = campaign.surface
    point = trial.point if trial.point is not None else surface.point
    slope, on_surface = trial.slope, None
    if point is None and surface.markers:
        on_surface, measured, residual = marker_plane(
            recording, surface.markers, frame, surface.marker_height, slope
        )
        if measured is not None:
            notes.append(f"board markers lie {1000 * residual:.2f} mm rms off their plane")
            if slope is not None and abs(slope - measured) > _SLOPE_DOUBT:
                notice(
                    "slopes-differ",
                    f"the board markers say {np.degrees(measured):.1f} deg, the campaign "
                    f"{np.degrees(slope):.1f} deg; the campaign's slope is used",
                    trial=trial.name,
                    size=abs(slope - measured),
                )
            slope = measured if slope is None else slope
    if slope is None:
        raise LogError(f"trial {trial.name!r}: no slope; give it")
    if on_surface is not None:
        return slope, on_surface
    if point is not None:
        return slope, frame.matrix @ np.asarray(point)
    assert rest is not None  # the campaign was validated: one of three ways is there
    motion = _motion(campaign, None, rest, frame)
    centre = np.median(motion.position[motion.valid], axis=0)
    depth = campaign.vehicle.foot_dz - _static_sag(campaign)
    return slope, centre - depth * np.array([np.sin(slope), 0.0, np.cos(slope)])


def _static_sag(campaign: GearCampaign) -> float:
    """Return how far the body sinks on its nominal legs at rest [m]: axial, bending and ground in series."""
    value = parameters_on(campaign.surface.law).nominal
    vehicle = campaign.vehicle
    axial, bending, ground = (value[f"{name}_stiffness"] for name in ("leg_axial", "leg_bending", "ground"))
    span = vehicle.foot_dx - value["joint_dx"]
    compliance = 1 / axial + span**2 / bending + 1 / ground
    return 0.5 * vehicle.body_mass * vehicle.gravity * compliance


def _window(
    campaign: GearCampaign,
    trial: GearTrial,
    motion: PlanarMotion,
    plane: SlopedPlane,
    flight: Flight,
    touchdown: float,
    margin: int,
    where: str,
    notes: list[str],
) -> slice:
    """Return the samples that are compared, from just before contact to the end of window, board or log.

    The filter needs `margin` samples on both sides.
    """
    settings = campaign.window
    start_time = touchdown - settings.before_contact
    if flight.held:
        start_time = max(start_time, flight.start)
    first = int(np.searchsorted(motion.time, start_time - 1e-9))
    last = int(np.searchsorted(motion.time, touchdown + settings.after_contact + 1e-9))
    off_board = _off_board(campaign, motion, plane, flight, touchdown, last)
    if off_board is not None:
        last = off_board
        notes.append(f"the body leaves the board {motion.time[last] - touchdown:.2f} s after touchdown")
    if first - margin < 0:
        raise LogError(
            f"{where}: the window starts {first} samples into the log, the filter needs {margin} before it; "
            f"start recording earlier"
        )
    ends_early = last + margin > len(motion.time)
    if ends_early:
        last = max(0, len(motion.time) - margin)
    if last - first < _LEAST_SAMPLES or motion.time[min(last, len(motion.time)) - 1] < touchdown:
        raise LogError(
            f"{where}: only {max(0, last - first)} samples are left in the window around the touchdown at "
            f"{touchdown:.3f} s; record longer (the filter needs {margin} samples after the window)"
        )
    if ends_early:
        kept = float(motion.time[last - 1] - touchdown)
        notes.append(f"the log ends early: the window ends {kept:.2f} s after the touchdown")
        notice(
            "log-ends-early",
            f"the log ends early: its window ends {kept:.2f} s after the touchdown instead of "
            f"{settings.after_contact:.2g} s (the filter needs {margin} samples more); the drop counts as "
            "much as the others",
            trial=trial.name,
            size=settings.after_contact - kept,
        )
    lost = runs(~motion.valid[first - margin : last + margin])
    begin, end = max(lost, key=lambda run: run[1] - run[0], default=(0, 0))
    gap = (end - begin) / motion.rate
    if gap > settings.max_gap + 1e-9:
        raise LogError(
            f"{where}: the body is lost for {1000 * gap:.0f} ms from "
            f"{motion.time[first - margin + begin]:.3f} s, longer than window.max_gap "
            f"({1000 * settings.max_gap:.0f} ms); record the drop again or shorten the window"
        )
    return slice(first, last)


def _off_board(
    campaign: GearCampaign,
    motion: PlanarMotion,
    plane: SlopedPlane,
    flight: Flight,
    touchdown: float,
    last: int,
) -> int | None:
    """Return the first sample before `last` at which the body has slid off the board; None if it stays."""
    if campaign.surface.board_length is None:
        return None
    tangent = np.array([np.cos(plane.angle), -np.sin(plane.angle)])
    along = np.column_stack([motion.x, motion.z]) @ tangent
    at_touchdown = int(np.clip(np.searchsorted(motion.time, touchdown), 0, len(along) - 1))
    origin = along[at_touchdown]
    if not np.isfinite(origin):
        origin = float(flight.at(np.array([touchdown]))[0, :2] @ tangent)
    left = np.flatnonzero(along[at_touchdown:last] - origin > campaign.surface.board_length)
    return at_touchdown + int(left[0]) if len(left) else None


def _target(
    campaign: GearCampaign,
    trial: GearTrial,
    motion: PlanarMotion,
    window: slice,
    lowpass: KaiserLowpass | None,
    margin: int,
) -> tuple[TrialTarget, Spectrum | None, FloatArray, int]:
    """Filter and differentiate the measured window with its margins.

    Returns the target, the spectrum before the filter, the sample times of the margin before the window and
    the samples of the one after.
    """
    wide = slice(window.start - margin, window.stop + margin)
    seen = motion.valid[wide]
    filled = bridge_gaps(motion.coordinates()[wide], seen)
    smooth = filled if lowpass is None else lowpass.apply(filled)
    rates = differentiate(smooth, motion.rate)
    measured = _channels(smooth, rates)
    raw = _channels(filled, differentiate(filled, motion.rate))[1:-1]
    spectrum = None if lowpass is None else amplitude_spectrum(raw, motion.rate)
    same_way = campaign.filter.kind == "none" or campaign.filter.filter_simulation
    target = TrialTarget(
        name=trial.name,
        measured=measured[margin:-margin],
        valid=seen[margin:-margin],
        rate=motion.rate,
        taps=lowpass.taps if lowpass is not None and same_way else None,
        delivered=seen if same_way else None,
    )
    simulated_margin = margin if same_way else 0
    return target, spectrum, motion.time[window.start - simulated_margin : window.start], simulated_margin


def _channels(coordinates: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the compared channels (n, 5) of x, z, pitch and their rates, as `cost_channels` orders them."""
    return np.column_stack([coordinates[:, :2], rates[:, :2], coordinates[:, 2]])


def _doubts(
    trial: GearTrial, motion: PlanarMotion, window: slice, flight: Flight, touchdown: float, gravity: float
) -> None:
    for angle, values in (("roll", motion.roll), ("yaw", motion.yaw)):
        largest = float(np.nanmax(np.abs(values[window])))
        if largest > PLANAR_LIMIT:
            notice(
                f"{angle}-out-of-plane",
                f"{angle} reaches {np.degrees(largest):.0f} deg, the planar model assumes less than "
                f"{np.degrees(PLANAR_LIMIT):.0f} deg",
                trial=trial.name,
                size=largest,
            )
    measured = flight.measured_gravity
    wrong = abs(measured / gravity - 1)
    if touchdown - flight.start > _TELLS_GRAVITY and wrong > _GRAVITY_DOUBT:  # False of an unknown g, NaN
        notice(
            "unlikely-gravity",
            f"the fall shows {measured:.1f} m/s² instead of {gravity:.2f}; check the length unit, capture.up "
            "and that nothing brakes the body",
            trial=trial.name,
            size=wrong,
        )
    late = _leaves_free_fall(motion, flight, touchdown) - touchdown
    if not -_EARLY < late < _LATE:
        side, level = ("after", "high") if late > 0 else ("before", "low")
        off = -flight.at(np.array([touchdown]))[0, 4] * abs(late - _YIELDING)
        notice(
            "doubtful-surface",
            f"the body leaves free fall {1000 * abs(late):.0f} ms {side} the feet should touch; the surface "
            f"plane may lie about {1000 * off:.0f} mm too {level}",
            trial=trial.name,
            size=abs(late),
        )


def _leaves_free_fall(motion: PlanarMotion, flight: Flight, touchdown: float) -> float:
    """Return when the height or pitch first leaves the flight model for good [s]."""
    near = (motion.time > touchdown - 0.1) & (motion.time < touchdown + 0.1) & motion.valid
    error = np.abs(motion.coordinates()[near] - flight.at(motion.time[near])[:, :3])
    limit = np.maximum(6 * flight.noise, [np.inf, 1e-3, 0.01])
    away = np.asarray((error[:, 1:] > limit[1:]).any(axis=1))
    inside = np.flatnonzero(~away)
    later = motion.time[near][inside[-1] + 1 :] if len(inside) else motion.time[near]
    return float(later[0]) if len(later) else float("inf")
