"""Figures of logs as they were recorded: what `inspect` draws."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.recording import COMPONENTS, Channel, Recording
from sysid.report.drawing import BEST, MEASURED, RUNS, as_words, paper
from sysid.trials.look import LogReport

# Channels that tell most about a bench log, most telling first.
_FIRST = ("command", "speed", "thrust", "torque", "voltage", "current")
# Greatest number of drawn channels of a log, and of drawn points of a channel.
_MOST_ROWS, _MOST_POINTS = 6, 20_000
# Longest name of a file in a title [characters].
_LONGEST = 60


def _chosen(recording: Recording, report: LogReport) -> list[Channel]:
    channels = recording.channels
    if recording.kind == "motion-capture":
        names = [f"{body}/{part}" for body in recording.rigid_bodies for part in ("position", "orientation")]
        names = names or [f"{marker}/position" for marker in recording.markers]
        if report.drop is not None:
            first = [f"{report.drop.body}/{part}" for part in ("position", "orientation")]
            names = [*first, *(name for name in names if name not in first)]
    else:
        names = [name for name in _FIRST if name in channels]
        names += [name for name in channels if name not in names]
    return [channels[name] for name in names if name in channels][:_MOST_ROWS]


def _draw(axes: Axes, channel: Channel, points: bool, change: bool = False) -> None:
    step = max(1, channel.time.size // _MOST_POINTS)
    time = channel.time[::step]
    columns = channel.values[::step].reshape(time.size, -1)
    if change:  # a fall of centimetres is not seen in coordinates of metres
        columns = columns - columns[int(np.argmax(np.isfinite(columns).all(axis=1)))]
    labels = COMPONENTS.get(columns.shape[1], "")
    style = {"marker": "o", "linestyle": "none"} if points else {"linewidth": 0.9}
    for i in range(columns.shape[1]):
        colour = MEASURED if columns.shape[1] == 1 else RUNS[i]
        label = labels[i] if labels else None
        axes.plot(time, columns[:, i], color=colour, label=label, rasterized=True, **style)
        present = np.pad(np.isfinite(columns[:, i]), 1)
        lone = present[1:-1] & ~present[:-2] & ~present[2:]
        if lone.any() and not points:  # a line does not show a sample between two blanks
            axes.plot(time[lone], columns[lone, i], ".", color=colour, markersize=3.0, rasterized=True)
    if points:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if labels:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0, ncols=len(labels),
            frameon=False, fontsize="small",
        )  # fmt: skip
    # A pure number, such as a part of a quaternion, has the unit 1.
    unit = f" [{channel.unit or '1'}]"
    name = channel.name.replace("/", "\n") + (" change" if change else "")
    axes.set_ylabel(as_words(name + unit), fontsize="small")
    axes.grid(True, color="0.9")


def figure_logs(recordings: Sequence[Recording], reports: Sequence[LogReport]) -> Figure:
    """Draw the main channels of logs over time, a block of rows each.

    Thin lines mark the release and the touchdown of a drop.
    """
    blocks = [_chosen(recording, report) for recording, report in zip(recordings, reports, strict=True)]
    rows = max(1, sum(len(block) for block in blocks))
    figure = Figure(figsize=(9.5, 1.2 + 1.5 * rows), layout="constrained")
    all_axes = figure.subplots(rows, 1, squeeze=False)[:, 0]
    row = 0
    for recording, report, block in zip(recordings, reports, blocks, strict=True):
        points = recording.kind == "static-map"
        shared = None
        for place, channel in enumerate(block):
            axes = all_axes[row]
            row += 1
            falls = report.drop is not None and channel.name == f"{report.drop.body}/position"
            _draw(axes, channel, points, change=falls)
            if shared is not None:
                axes.sharex(shared)
            shared = shared or axes
            if place == 0:
                name = Path(report.path).name
                short = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"
                axes.set_title(as_words(f"{short} ({report.kind})"), fontsize="medium", loc="left")
            if report.drop is not None and falls:
                for word, at in (("release", report.drop.release), ("touchdown", report.drop.touchdown)):
                    if at is not None:
                        axes.axvline(at, color=BEST, linewidth=0.8)
                        axes.annotate(
                            word, (at, 0.03), xycoords=("data", "axes fraction"), fontsize="small",
                            ha="right" if word == "release" else "left", color=BEST,
                            xytext=(-3 if word == "release" else 3, 0), textcoords="offset points",
                            bbox=paper(1.0),
                        )  # fmt: skip
            if place == len(block) - 1:
                axes.set_xlabel("point" if points else "time [s]")
    return figure
