"""What an instrument recorded: named channels in SI, each with its clock, write-locked.

A loader makes a `Recording` from one file, and nothing changes its numbers later. A sample that the
instrument did not deliver (a blank cell, an occluded frame) is NaN at its time and not `Channel.valid`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.shown import Shown
from sysid.types import BoolArray, FloatArray

if TYPE_CHECKING:
    import pandas as pd

# Names of the components of a position and of a quaternion.
COMPONENTS = {3: "xyz", 4: "wxyz"}


def _locked(values: object) -> FloatArray:
    # Channels of one log share their clock: a write-locked array needs no copy.
    if (
        isinstance(values, np.ndarray)
        and values.dtype == np.float64
        and values.base is None
        and values.flags.c_contiguous
        and not values.flags.writeable
    ):
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False, repr=False)
class Channel:
    """One quantity over time."""

    name: str  # such as ``speed``, ``thrust``, ``F450/position``
    unit: str  # SI, but a command keeps the unit of its protocol, such as ``us``
    time: FloatArray  # (n,) strictly increasing, on the file's own clock [s]
    values: FloatArray  # (n,) or (n, k); NaN where the instrument delivered none

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _locked(self.time))
        object.__setattr__(self, "values", _locked(self.values))
        if self.time.ndim != 1 or self.values.ndim not in (1, 2) or len(self.values) != len(self.time):
            raise ValueError(f"channel {self.name}: {self.values.shape} samples on {self.time.shape} times")
        if self.time.size > 1 and not np.all(np.diff(self.time) > 0):
            raise ValueError(f"channel {self.name}: time does not increase")

    def __repr__(self) -> str:
        return f"<Channel {self.name} [{self.unit or '1'}]: {self.time.size} samples, {self.rate:.5g} Hz>"

    @property
    def valid(self) -> BoolArray:
        """(n,) True where every component was delivered."""
        finite = np.isfinite(self.values)
        return np.asarray(finite if finite.ndim == 1 else finite.all(axis=1), dtype=np.bool_)

    @property
    def rate(self) -> float:
        """Median sample rate [Hz]; NaN below two samples."""
        return float(1.0 / np.median(np.diff(self.time))) if self.time.size > 1 else float("nan")


@dataclass(frozen=True)
class Provenance:
    """Where a recording comes from."""

    path: str  # the file as it was named
    sha256: str  # hash of its bytes
    format: str  # loader that read it, e.g. ``motive-csv``
    device: str = ""  # instrument and version as the file states them, or empty
    # Loader options that changed the numbers (rate, quaternion order, units), as text.
    options: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[Finding, ...] = ()  # findings of the loader and its acts: rows dropped, signs flipped

    @property
    def sentences(self) -> list[str]:
        """The notes in words, as files and terminals state them."""
        return [str(note) for note in self.notes]

    @property
    def source(self) -> dict[str, str]:
        """File, hash, format and device, as a result states them."""
        head = {"log": Path(self.path).name, "sha256": self.sha256}
        return head | {"format": self.format, "device": self.device}


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """Channels of one file with their provenance.

    Rigid bodies are two channels, ``NAME/position`` (n, 3) [m] and ``NAME/orientation`` (n, 4) unit
    quaternion, **w first**, rotating body axes into capture axes, continuous in sign; a marker is one
    channel ``NAME/position``.
    """

    kind: str
    channels: Mapping[str, Channel]
    provenance: Provenance

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))

    def __repr__(self) -> str:
        name = Path(self.provenance.path).name
        ends = [c.time[[0, -1]] for c in self.channels.values() if c.time.size]
        length = f"{np.ptp(ends):.4g} s" if ends else "no sample"
        return f"<Recording {name} ({self.kind}): {', '.join(self.channels) or 'no channel'}; {length}>"

    def to_frame(self) -> pd.DataFrame:
        """Return the channels as columns such as ``speed [rad/s]`` over the time [s].

        A vector has a column for each component. Where channels have clocks of their own, a row has NaN for
        those that have no sample at its time.
        """
        import pandas as pd

        frames = []
        for channel in self.channels.values():
            width = 1 if channel.values.ndim == 1 else channel.values.shape[1]
            parts = [""] if width == 1 else [f" {c}" for c in COMPONENTS.get(width, range(1, width + 1))]
            names = [f"{channel.name}{part} [{channel.unit or '1'}]" for part in parts]
            clock = pd.Index(channel.time, name="time [s]")
            frames.append(pd.DataFrame(channel.values.reshape(-1, width), clock, names))
        return pd.concat(frames, axis=1).sort_index() if frames else pd.DataFrame()

    def remarks(self) -> tuple[Finding, ...]:
        """Return what the loader noticed and did."""
        return self.provenance.notes

    @property
    def rigid_bodies(self) -> tuple[str, ...]:
        """Names that have an orientation, in file order."""
        return tuple(n.removesuffix("/orientation") for n in self.channels if n.endswith("/orientation"))

    @property
    def markers(self) -> tuple[str, ...]:
        """Names that have a position and no orientation, in file order."""
        placed = (n.removesuffix("/position") for n in self.channels if n.endswith("/position"))
        return tuple(n for n in placed if f"{n}/orientation" not in self.channels)

    def __getitem__(self, name: str) -> Channel:
        """Return a channel by name; LogError where the file has none of that name."""
        try:
            return self.channels[name]
        except KeyError:
            has = ", ".join(self.channels) or "none"
            raise LogError(f"{self.provenance.path}: no channel {name!r}; found {has}").also(
                KeyError
            ) from None


def file_sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file's bytes as hex."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
