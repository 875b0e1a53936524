"""Read the bench logs that a motor campaign names: its options, a second file with its own clock."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.campaign.file import resolve_log
from sysid.campaign.logs import BenchLogOptions
from sysid.campaign.motor import MotorTrial, StaticLog
from sysid.campaign.read_logs import load_stated, warn_of_idle_options
from sysid.errors import SysidWarning
from sysid.loaders import detect
from sysid.loaders.alignment import join_recordings
from sysid.recording import Recording
from sysid.trials.bench_log import wrong_poles
from sysid.trials.common_clock import on_one_clock

_NEEDED = ("command", "speed", "torque", "thrust", "voltage", "current")
_CLOCK_OF = ("torque", "thrust", "speed")


@dataclass(frozen=True, eq=False)
class BenchFile:
    """A log of the campaign as a fit needs it.

    Parameters
    ----------
    recording : Recording
        Command, speed, torque, thrust, voltage and current on one clock.
    second : dict or None
        Of a second file: name, hash, format, device, clock offset [s] with its correlation and confidence.
    """

    recording: Recording
    second: dict[str, Any] | None = None


def read_log(campaign: MotorCampaign, path: str | Path, entry: MotorTrial | StaticLog) -> BenchFile:
    """Load a log of the campaign, joined with its second file where it has one.

    Parameters
    ----------
    campaign : MotorCampaign
        Its `[log]` table holds for every log whose format takes the option.
    path : str or Path
        The campaign's file; logs are named relative to its folder.
    entry : MotorTrial or StaticLog
        Names the log; its `log_options` win over `[log]`.

    Raises
    ------
    SysidError
        When a log cannot be read, or the clock of the second one cannot be found.
    """
    log = resolve_log(path, entry.log)
    other = None if entry.second_log is None else resolve_log(path, entry.second_log.log)
    own = entry.log_options
    name = own.format or campaign.log.format or "auto"
    name = detect(log) if name == "auto" else name
    recording = load_stated(log, name, _campaign_wide(campaign, name, own), own.loader_options())
    ratio = _electrical_share(recording)
    if ratio is not None:
        warnings.warn(f"{recording.provenance.path}: {wrong_poles(ratio)}", SysidWarning, stacklevel=2)
    second = None
    if other is not None and entry.second_log is not None:
        # Another instrument: nothing that the campaign says of its logs is said of this one.
        beside = load_stated(other, entry.second_log.format, {}, entry.second_log.loader_options())
        recording, found = join_recordings(recording, beside, entry.second_log.align_by)
        said = beside.provenance
        second = {
            "log": other.name,
            "sha256": said.sha256,
            "format": said.format,
            "device": said.device,
            "aligned": f"{found.other} with {found.reference}",
            "offset [s]": found.offset,
            "correlation": found.correlation,
            "confidence": found.confidence,
            "notes": said.sentences,
        }
    return BenchFile(on_one_clock(recording, _NEEDED, _CLOCK_OF), second)


def log_hashes(provenance: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a log as its provenance states it, and of its second file where it has one."""
    second = provenance.get("second log", {})
    return " ".join(str(one["sha256"]) for one in (provenance, second) if one)


def check_options(campaign: MotorCampaign, path: str | Path) -> None:
    """Warn of what `[log]` says and no log of the campaign takes."""
    curves = campaign.curves
    entries: tuple[MotorTrial | StaticLog, ...] = (*campaign.trials, *curves.static, *curves.no_load)
    logs = [(resolve_log(path, one.log), one.log_options.format or campaign.log.format) for one in entries]
    warn_of_idle_options("log", campaign.log.loader_options(), logs)


def _campaign_wide(campaign: MotorCampaign, name: str, own: BenchLogOptions) -> dict[str, Any]:
    """Return what `[log]` says, with its short forms of units in the words of the format."""
    options = campaign.log
    short = {
        "command": options.command_unit, "thrust": options.force_unit, "torque": options.torque_unit,
        "speed": options.speed_unit,
    }  # fmt: skip
    if name == "ati-text":  # six channels by place, which share two units
        short = {"force": options.force_unit, "torque": options.torque_unit}
    units = {**(options.units or {}), **{key: unit for key, unit in short.items() if unit is not None}}
    stated = options.loader_options() | {"units": units or None}
    if own.calibration is not None:  # states its own units
        stated["units"] = None
    return stated


def _electrical_share(recording: Recording) -> float | None:
    """Return the constant ratio of electrical to optical speed where it is not 1; None otherwise."""
    if not {"speed_electrical", "speed_optical"} <= set(recording.channels):
        return None
    electrical, optical = recording["speed_electrical"].values, recording["speed_optical"].values
    both = (np.nan_to_num(optical) != 0) & (np.nan_to_num(electrical) != 0)
    if np.count_nonzero(both) < 3:
        return None
    ratio = electrical[both] / optical[both]
    low, middle, high = np.percentile(ratio, [25, 50, 75])
    # One pole pair of fourteen is 7 %; probes that agree differ by well under 2 %.
    return float(middle) if abs(middle - 1.0) > 0.02 and high - low < 0.02 * middle else None
