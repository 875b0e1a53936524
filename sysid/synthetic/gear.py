"""Drops of a drone on slopes, simulated and written as a motion-capture system would have recorded them.

In each drop a magnet keeps the drone level and at rest, then releases it; it falls freely and lands. The axes
and the origin of the room differ from the model's. The board is hinged about a line through one surveyed
point, which therefore lies on the surface at every slope. The rigid body's origin is not the centre of mass,
and its axes are not quite level while the drone is.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from sysid.campaign import TrialUse
from sysid.errors import CampaignError, ExportError
from sysid.gear import model
from sysid.storage import check_folder
from sysid.synthetic.folder import TRUTH_FILE, Content, truth_text, write_campaign
from sysid.synthetic.motion_capture import Take, motive_csv, observe, pose_table_csv
from sysid.trials.capture import CaptureFrame
from sysid.types import FloatArray

Export = Literal["motive", "motive-mm", "motive-euler", "pose-table"]

_BODY = "F450"
_BOARD_MARKERS = ("board-1", "board-2", "board-3")
# Height of a marker's centre above the board [m].
_MARKER_HEIGHT = 7e-3
# Vector from the rigid body's origin to the centre of mass, in the body's axes (capture axes when level) [m].
_CENTRE_OF_MASS = (0.004, -0.022, 0.003)
# Place of the board's hinge line in the room, along (down-slope, into the page, up) [m].
_HINGE = (0.8125, -0.3640, 0.4305)
# Pitch, roll and yaw of the rigid body's axes while the drone hangs level [deg].
_BODY_AXES_DEG = (0.6, -0.4, 0.3)
# Length of a log after the contact [s].
_AFTER_CONTACT = 1.05
# Unix time of frame 0 of the streamed table [s].
_EPOCH = 1_700_000_000.0


# Units of the keys in the truth file. The state counts from the surface point, the travel is along the slope
# in 0.7 s.
_FACT_UNITS = {
    "Hz": "rate",
    "m": "position surface_point centre_of_mass_offset marker_height fall_height x_B z_B travel",
    "rad": "angle slope q_B",
    "m/s": "impact_speed",
    "s": "release touchdown",
}


@dataclass(frozen=True)
class DropPlan:
    """One drop to synthesize: angle of the board [rad], vertical speed when the rear foot touches [m/s]."""

    slope: float
    impact_speed: float
    use: TrialUse = "fit"
    export: Export = "motive"

    def __post_init__(self) -> None:
        if not 0.0 <= self.slope < math.radians(80):
            raise CampaignError(
                f"drop: slope of {math.degrees(self.slope):g} deg; expected 0 to 80 deg, give it in radians"
            )
        if not 0.0 < self.impact_speed <= 5.0:
            raise CampaignError(f"drop: impact speed of {self.impact_speed:g} m/s; expected 0 to 5 m/s")

    @property
    def name(self) -> str:
        """Slope and speed, as in ``15deg-0.60mps``."""
        return f"{math.degrees(self.slope):.4g}deg-{self.impact_speed:.2f}mps"


def _plan(slope_deg: float, speed: float, use: TrialUse = "fit", export: Export = "motive") -> DropPlan:
    return DropPlan(math.radians(slope_deg), speed, use, export)


LF_DROPS = (
    _plan(5, 0.5),
    _plan(10, 0.8, export="motive-mm"),
    _plan(15, 0.6),
    _plan(20, 1.0, export="motive-euler"),
    _plan(27, 0.7),
    _plan(35, 0.45, export="pose-table"),
    _plan(12, 0.7, "validate"),
    # Not faster: at 0.9 m/s it stands on the edge of tipping over, where 3 % of a parameter decide.
    _plan(24, 0.8, "validate", "motive-mm"),
)

# Chosen among 5 to 27 deg and 0.4 to 1 m/s: 2 % of every parameter move none of them by more than 35 % of its
# deviation, and none turns over; from 0.9 m/s on this surface flips the drone, and others stand on an edge.
HF_DROPS = (
    _plan(5, 0.4),
    _plan(12, 0.7, export="motive-mm"),
    _plan(15, 0.55),
    _plan(18, 0.6, export="motive-euler"),
    _plan(22, 0.65),
    _plan(27, 0.7, export="pose-table"),
    _plan(12, 0.45, "validate"),
    _plan(24, 0.65, "validate", "motive-mm"),
)


@dataclass(frozen=True)
class CaptureLab:
    """How drops are recorded."""

    # Standard deviations per axis and frame [m], [rad]; 0 leaves the quantization of the file only.
    noise_position: float = 0.3e-3
    noise_angle: float = math.radians(0.2)
    # Rate of the capture [Hz].
    rate: float = 200.0
    # Capture axes that point up and down the slope.
    up: str = "+y"
    down_slope: str = "-z"
    # Statement of the campaign about the surface; every log contains three board markers anyway.
    plane: Literal["point", "markers"] = "point"
    # Whether the body is lost for 1 to 4 frames three times per drop.
    occlusions: bool = True
    # Amplitude of roll and yaw after the contact [rad].
    wobble: float = math.radians(0.4)

    @property
    def frame(self) -> CaptureFrame:
        """Directions of the capture axes."""
        return CaptureFrame(self.up, self.down_slope)

    @property
    def hinge(self) -> FloatArray:
        """A point (3,) of the board's hinge line in capture axes [m]."""
        return self.frame.matrix.T @ np.array(_HINGE)


@dataclass(frozen=True, eq=False)
class _Truth:
    """One simulated drop on the capture's frames, in model axes from the hinge."""

    plan: DropPlan
    first_frame: int
    time: FloatArray
    release: float
    touchdown: float
    fall_height: float
    start: FloatArray
    coordinates: FloatArray
    travel: float
    # y (n,) [m] and n rotations from the body to (x, y, z), where the simulator knows space.
    pose: tuple[FloatArray, Rotation] | None


def synthesize_gear(
    folder: str | Path,
    *,
    seed: int,
    surface: str = "lf",
    drops: Sequence[DropPlan] | None = None,
    parameters: Mapping[str, float] | None = None,
    name: str | None = None,
    force: bool = False,
    simulate: Callable[..., model.GearTrajectory] = model.simulate,
    **lab: Any,
) -> Path:
    """Write a campaign of drops with known truth: ``campaign.toml``, one log per drop and ``truth.json``.

    CampaignError when the drops cannot be used or a simulation fails, ExportError when the folder exists,
    unless `force` replaces it, or cannot be written; nothing is written then.

    Same `seed`, same arguments: the same files, to the last byte on one platform. True values are the means
    of Table II for the `surface`, a friction law, but for `parameters` [SI]. At least one of the `drops`, by
    default `LF_DROPS` or `HF_DROPS`, has ``use = "fit"``. The campaign's `name` is ``synthetic-lf`` when left
    out. `simulate` drops the true gear, with the arguments of `sysid.gear.model.simulate`: another simulator
    may have physics that the model lacks. Where what it returns has a `pose`, y (n,) [m] and n rotations from
    the body to (x, y, z), the drop leaves the plane as that says. `lab` are fields of `CaptureLab`.
    """
    model.find_surface(surface)
    check_folder(folder, force=force, marker=TRUTH_FILE, error_type=ExportError)
    drops = tuple(drops if drops is not None else HF_DROPS if surface == "hf" else LF_DROPS)
    names = [drop.name for drop in drops]
    if len(set(names)) < len(names) or not any(drop.use == "fit" for drop in drops):
        raise CampaignError(
            f"drops: {', '.join(names) or 'none'}; give different drops, at least one of them to fit"
        )
    setup = CaptureLab(**lab)
    true = {**model.parameters_on(surface).nominal, **(parameters or {})}
    logs: dict[str, Content] = {}
    facts, trials = [], []
    for number, plan in enumerate(drops, start=1):
        # Children of one seed: a drop stays the same when another one is added.
        source = np.random.default_rng([seed, number])
        truth = _simulate(plan, true, surface, setup.rate, source, simulate)
        log = f"drop-{number}-{plan.name}.csv"
        take, marks = _record(number, truth, setup, source)
        if plan.export == "pose-table":
            logs[log] = pose_table_csv(take, _BODY, epoch=_EPOCH)
        else:
            logs[log] = motive_csv(
                take,
                unit="Millimeters" if plan.export == "motive-mm" else "Meters",
                rotation="XYZ" if plan.export == "motive-euler" else "Quaternion",
            )
        trials.append(_trial_text(number, plan, log, setup))
        # The clock of the facts is the clock of the log.
        shift = _EPOCH if plan.export == "pose-table" else 0.0
        x, z, pitch = (float(value) for value in truth.start[:3])
        fact = {
            "name": f"drop-{number}",
            "log": log,
            "export": plan.export,
            "use": plan.use,
            "slope": plan.slope,
            "impact_speed": plan.impact_speed,
            "fall_height": truth.fall_height,
            "release": shift + truth.release,
            "touchdown": shift + truth.touchdown,
            "state_at_release": {"x_B": x, "z_B": z, "q_B": pitch},
            "travel": round(truth.travel, 4),
            "first_frame": truth.first_frame,
        }
        facts.append({**fact, **marks})
    campaign = _campaign_text(name or f"synthetic-{surface}", true, surface, setup, seed)
    circumstances = {
        "surface": surface,
        "seed": seed,
        "rate": setup.rate,
        "noise": {"position": setup.noise_position, "angle": setup.noise_angle},
        "capture": {
            "up": setup.up,
            "down_slope": setup.down_slope,
            "surface_point": setup.hinge.tolist(),
            "centre_of_mass_offset": list(_CENTRE_OF_MASS),
            "body_axes_deg": list(_BODY_AXES_DEG),
            "marker_height": _MARKER_HEIGHT,
        },
        "free": list(model.find_surface(surface).free),
        "drops": facts,
    }
    truths = truth_text("gear", model.PARAMETERS, true, circumstances, _FACT_UNITS)
    return write_campaign(folder, campaign + "\n".join(trials), logs, truths, force=force)


def _simulate(
    plan: DropPlan,
    true: Mapping[str, float],
    surface: str,
    rate: float,
    source: np.random.Generator,
    simulate: Callable[..., model.GearTrajectory],
) -> _Truth:
    """Simulate one drop on capture frames that do not coincide with its release."""
    gravity = true["gravity"]
    first_frame = int(source.integers(300, 4000))
    wait = float(source.uniform(0.55, 0.75))
    release = first_frame / rate + wait
    fall = plan.impact_speed / gravity
    frames = math.ceil((wait + fall + _AFTER_CONTACT) * rate) + 1
    time = (first_frame + np.arange(frames)) / rate
    height = plan.impact_speed**2 / (2 * gravity)
    # The rear foot lands somewhere near 0.3 m up-slope of the hinge.
    foot_x = -float(source.uniform(0.26, 0.34)) * math.cos(plan.slope)
    foot_z = -foot_x * math.tan(plan.slope) + height
    start = np.array([foot_x + true["foot_dx"], foot_z + true["foot_dz"], 0.0, 0.0, 0.0, 0.0])
    falling = time > release
    clock = np.concatenate([[release], time[falling]])
    run = simulate(true, plan.slope, start, clock, surface=surface, tolerance=model.TIGHT_TOLERANCE)
    if run.status is not model.Status.OK:
        raise CampaignError(
            f"drop {plan.name}: the true parameters cannot be simulated ({run.status.text}); change them"
        )
    coordinates = np.tile(run.state[0, :3], (frames, 1))
    coordinates[falling] = run.state[1:, :3]
    window = time[falling] <= release + fall + 0.7
    along = np.array([math.cos(plan.slope), -math.sin(plan.slope)])
    travel = float(np.max((coordinates[falling][window][:, :2] - start[:2]) @ along))
    pose = getattr(run, "pose", None)
    if pose is not None:  # the first pose is of the release, before which the body hangs in it
        which = np.cumsum(falling)
        pose = pose[0][which], pose[1][which]
    return _Truth(plan, first_frame, time, release, release + fall, height, start, coordinates, travel, pose)


def _record(
    number: int, truth: _Truth, lab: CaptureLab, source: np.random.Generator
) -> tuple[Take, dict[str, list[list[int]] | list[int]]]:
    """Turn the planar truth into what the cameras of the room saw."""
    count, frame, hinge, rate = len(truth.time), lab.frame, lab.hinge, lab.rate
    noise = (lab.noise_position, lab.noise_angle)
    x, z, pitch = truth.coordinates.T
    if truth.pose is None:
        elapsed = np.maximum(0.0, truth.time - truth.touchdown)
        # Off the plane: nothing before the contact, then a small wobble and a slow drift.
        swing = np.sin(2 * math.pi * 1.7 * elapsed)
        roll, yaw = lab.wobble * swing, -0.7 * lab.wobble * np.sin(2 * math.pi * 1.1 * elapsed)
        aside = 0.031 + 0.004 * elapsed
        turn = Rotation.from_euler("YXZ", np.column_stack([pitch, roll, yaw]))
    else:
        aside, turn = truth.pose
    into_page = Rotation.from_matrix(frame.matrix.T)
    axes = Rotation.from_euler("YXZ", _BODY_AXES_DEG, degrees=True)
    # While the drone hangs level, only the definition of the rigid body turns it against the room.
    rotation = into_page * turn * axes * into_page.inv()
    centre = hinge + np.column_stack([x, aside, z]) @ frame.matrix
    origin = centre - rotation.apply(np.array(_CENTRE_OF_MASS))
    released = int(np.searchsorted(truth.time, truth.release))
    touch = int(np.searchsorted(truth.time, truth.touchdown))
    gaps = []
    if lab.occlusions:
        starts = [
            source.integers(10, released - 45),
            source.integers(touch + round(0.06 * rate), touch + round(0.30 * rate)),
            source.integers(touch + round(0.40 * rate), touch + round(0.65 * rate)),
        ]
        gaps = [(int(start), int(source.integers(1, 5))) for start in starts]
    flips = sorted(int(sample) for sample in source.integers(5, count - 5, size=2))
    body = observe(origin, rotation, noise, source, gaps=gaps, flips=flips)
    slope = truth.plan.slope
    along = np.array([math.cos(slope), 0.0, -math.sin(slope)])
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    markers = {}
    # Places on the board: along the slope from the hinge, and across [m].
    for name, (s, y) in zip(_BOARD_MARKERS, ((-0.62, -0.28), (-0.58, 0.30), (0.11, 0.27)), strict=True):
        local = s * along + np.array([0.0, y, 0.0]) + _MARKER_HEIGHT * normal
        shaken = lab.noise_position * source.standard_normal((count, 3))
        markers[name] = hinge + local @ frame.matrix + shaken
    # Another rigid body lies about in the room.
    place = hinge + frame.matrix.T @ np.array([0.9, 0.7, 0.1])
    turn = Rotation.from_rotvec(np.tile([0.0, math.radians(37.0), 0.0], (count, 1)))
    wand = observe(np.tile(place, (count, 1)), turn, noise, source)
    started = f"2024-03-0{1 + number % 7} 10.{10 + number % 50:02d}.07.412 AM"
    take = Take(f"drop-{number}", started, truth.first_frame, rate, {"wand": wand, _BODY: body}, markers)
    return take, {"occlusions": [list(gap) for gap in gaps], "sign_flips": flips}


def _quantity(value: float, unit: str, scale: float = 1.0) -> str:
    """Return a TOML string of an SI value in a unit that is `scale` times smaller."""
    return f'"{scale * value:.10g} {unit}"'


def _point(values: Iterable[float]) -> str:
    return "[" + ", ".join(_quantity(value, "mm", 1e3) for value in values) + "]"


def _trial_text(number: int, plan: DropPlan, log: str, lab: CaptureLab) -> str:
    """Return one ``[[trials]]`` table, with a point of the surface where the log lacks needed markers."""
    slope = _quantity(math.degrees(plan.slope), "deg")
    text = (
        "[[trials]]\n"
        f'name = "drop-{number}"\n'
        f'log = "{log}"\n'
        f"slope = {slope}  # inclinometer; impact near {plan.impact_speed:g} m/s\n"
        f'use = "{plan.use}"\n'
    )
    if plan.export == "pose-table" and lab.plane == "markers":
        text += f"point = {_point(lab.hinge)}  # no board markers in this log\n"
    return text


def _campaign_text(name: str, true: Mapping[str, float], surface: str, lab: CaptureLab, seed: int) -> str:
    """Return the campaign file without its trials: what the lab measured, not what is to be identified."""
    if lab.plane == "point":
        where = f"point = {_point(lab.hinge)}  # on the board's hinge line: on the surface at every slope"
    else:
        named = ", ".join(f'"{marker}"' for marker in _BOARD_MARKERS)
        height = _quantity(_MARKER_HEIGHT, "mm", 1e3)
        where = (
            f"markers = [{named}]  # on the board\n"
            f"marker_height = {height}  # of a marker's centre above the surface"
        )
    legs, friction = f"leg_mass_fraction = {true['leg_mass_fraction']:.10g}", ""
    if surface == "lf":  # identified elsewhere, not measured
        legs = (
            f"leg_mass = {_quantity(true['leg_mass'], 'kg')}  # of the pair of legs at one end\n"
            f"leg_inertia = {_quantity(true['leg_inertia'], 'kg·m²')}  # about its own centre of mass\n"
            f"{legs}  # centre of mass, from the foot"
        )
        friction = (
            f"kinetic_friction = {true['kinetic_friction']:.10g}  # tilted board: tan(angle)\n"
            f"slip_regularization = {_quantity(true['slip_regularization'], 'm/s')}\n"
        )
    return f"""\
# Synthesized drops with known truth (truth.json, which no fit reads). Logs as a motion capture exports them.
kind = "gear"
name = "{name}"

[vehicle]
body_mass = {_quantity(true["body_mass"], "kg")}  # scale, without the legs
body_inertia = {_quantity(true["body_inertia"], "kg·m²")}  # bifilar pendulum, pitch axis
foot_dx = {_quantity(true["foot_dx"], "mm", 1e3)}  # centre of mass to foot, legs unloaded
foot_dz = {_quantity(true["foot_dz"], "mm", 1e3)}
thrust_point_dx = {_quantity(true["thrust_point_dx"], "mm", 1e3)}
{legs}
gravity = {_quantity(true["gravity"], "m/s²")}

[capture]
rigid_body = "{_BODY}"
up = "{lab.up}"
down_slope = "{lab.down_slope}"
centre_of_mass_offset = {_point(_CENTRE_OF_MASS)}  # balanced on an edge, from the body's pivot
level = "release"  # the magnet holds it level

[surface]
law = "{surface}"
{friction}{where}
board_length = "1.2 m"

[fit]
runs = 5
seed = {seed}
exact = true  # the values above are the truth, not measurements

"""
