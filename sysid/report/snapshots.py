"""A drone drawn to scale at an instant of a drop: snapshots as in Fig. 7, and films (GIF, MP4)."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from sysid.errors import ExportError
from sysid.report.drawing import (
    WIDTH,
    arrow,
    as_words,
    directions,
    draw_legend,
    draw_line,
    panels,
    without_glyph_warnings,
)
from sysid.report.drop_replay import DroneShape, DropReplay, drone_of, placed
from sysid.types import FloatArray

NORMAL, FRICTION = "#0072B2", "#D55E00"
GROUND, BODY, LEG, GHOST = "#8C7A5B", "#333333", "#555555", "#B0B0B0"
# Length of the longest arrow of a force [m].
_LONGEST = 0.22
# Number of samples to both sides of an instant, among which its arrows show the largest force.
_NEAR = 8
# Frames per second of a film.
FILM_RATE = 20
# Factor by which a film is slower than life [1].
SLOW = 10.0


def figure_snapshots(drop: DropReplay, *, legend: bool = False) -> Figure:
    """Draw the instants (1) to (4) of Fig. 7 of a drop.

    At the very instant of a touch or a lift-off the foot's force is zero: arrows show the sample within
    8 ms in which the feet bear most.
    """
    instants = drop.first_contacts()
    around = (0.0, 0.55 if legend else 0.1)
    figure, every = panels(len(instants), 2, (0.5 * WIDTH, 1.95), around)
    for number, ((time, _), axes) in enumerate(zip(instants, every, strict=True), start=1):
        i = drop.index(time)
        first = max(i - _NEAR, 0)
        loaded = first + int(np.argmax(drop.normal_force[first : i + _NEAR + 1].sum(axis=1)))
        x, z, _ = drop.body[i]
        _draw_drone(axes, drop, i, loaded)
        axes.set(xlim=(x - 0.28, x + 0.28), ylim=(z - 0.25, z + 0.2))
        axes.set_title(f"({number}) {1e3 * time:.0f} ms", fontsize=9, loc="left")
    if legend:
        entries = [
            (NORMAL, "line", "normal force"), (FRICTION, "line", "friction"),
            (BODY, "line", "simulated, best set"), (GHOST, "line", "measured body"),
        ]  # fmt: skip
        draw_legend(figure, entries, "outside lower center", 2, fontsize=8)
    return figure


def _draw_drone(axes: Axes, drop: DropReplay, i: int, loaded: int) -> None:
    """Draw slope, drone and the measured ghost at sample `i`, with the forces of sample `loaded` [m]."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    along, normal = directions(drop.slope)
    draw_slope(axes, drop.slope, 5.0)
    drone = drone_of(drop.values)
    if np.isfinite(drop.measured[i]).all():
        ghost = drop.measured[i]
        draw_drone(axes, drone, ghost, placed(drone.feet, ghost), GHOST, "none", 1.0, zorder=2)
    draw_drone(axes, drone, drop.body[i], drop.feet[i], BODY, "#DDDDDD", 2.0, zorder=4)
    # Length of an arrow per force [m/N].
    scale = _LONGEST / max(float(np.nanmax(np.abs(drop.normal_force), initial=0.0)), 1e-9)
    for foot in (0, 1):
        start = drop.feet[i, foot]
        for force, way, colour in (
            (drop.normal_force[loaded, foot], normal, NORMAL),
            (drop.friction_force[loaded, foot], along, FRICTION),
        ):
            if abs(force) * scale > 2e-3:
                arrow(axes, start, start + scale * force * way, colour, 1.8)


def draw_slope(axes: Axes, slope: float, far: float, origin: FloatArray | float = 0.0) -> None:
    """Draw a slope [rad] through a point, as far as `far` to both sides and below."""
    along, normal = directions(slope)
    corners = [(-far, 0), (far, 0), (far, -far), (-far, -far)]
    ground = [origin + a * along + b * normal for a, b in corners]
    axes.add_patch(Polygon(ground, facecolor="#E9E2D3", edgecolor=GROUND, linewidth=1.2, zorder=1))


def draw_drone(
    axes: Axes, drone: DroneShape, body: FloatArray, feet: FloatArray, colour: str, face: str, width: float,
    *, zorder: int,
) -> None:  # fmt: skip
    """Draw a drone in frame N: its body (3,) at x_B, z_B and pitch, its feet (2, 2)."""
    for leg in np.stack([placed(drone.joints, body), feet], axis=1):
        draw_line(axes, leg, colour, width + 0.6, zorder=zorder, solid_capstyle="round")
        axes.plot(*leg[1], marker="o", markersize=3 + width, color=colour, zorder=zorder)
    for rod in placed(drone.rods, body):
        draw_line(axes, rod, colour, width, zorder=zorder)
    hull = placed(drone.hull, body)
    axes.add_patch(Polygon(hull, facecolor=face, edgecolor=colour, linewidth=width, zorder=zorder))


def check_film(path: Path) -> None:
    """Raise an ExportError for a film of an unknown suffix, or where ffmpeg is missing."""
    suffix = path.suffix.lower()
    if suffix not in (".gif", ".mp4"):
        raise ExportError(f"{path}: unknown film format {suffix!r}; expected .gif or .mp4")
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise ExportError(f"{path}: ffmpeg was not found, and MP4 needs it; install ffmpeg, or write a .gif")


def film_bytes(drop: DropReplay, kind: str) -> bytes:
    """Return the content of a drop's film, ten times slower than life; `kind` is ``gif`` or ``mp4``."""
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = Figure(figsize=(6.4, 4.4), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 0.92))
    low, high = np.nanmin(drop.body[:, :2], axis=0) - 0.25, np.nanmax(drop.body[:, :2], axis=0) + 0.25
    shots = np.arange(0.0, float(drop.time[-1]), 1.0 / (SLOW * FILM_RATE))

    def draw(time: float) -> list[object]:
        axes.clear()
        i = drop.index(time)
        _draw_drone(axes, drop, i, i)
        # The slope reaches both edges of the picture, whatever the shape of the window: x may be widened.
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlim(low[0], high[0], auto=True)
        axes.set_ylim(low[1], high[1])
        figure.suptitle(
            f"{as_words(drop.name)}, {np.degrees(drop.slope):.0f}°, {1e3 * time:4.0f} ms, "
            f"{SLOW:g} × slow motion\nnormal force blue, friction red, measured grey",
            fontsize=10, y=0.98,
        )  # fmt: skip
        return []

    FigureCanvasAgg(figure)
    film = FuncAnimation(figure, draw, frames=list(shots), blit=False, cache_frame_data=False)  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"film.{kind}"
        writer = PillowWriter if kind == "gif" else FFMpegWriter
        with without_glyph_warnings():
            film.save(made, writer=writer(fps=FILM_RATE))
        return made.read_bytes()
