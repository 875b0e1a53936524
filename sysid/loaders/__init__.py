"""Logs in, one `Recording` out: SI, each channel on its own clock, what was not recorded masked.

    from sysid.loaders import load
    recording = load("step.csv")                                        # format judged by content
    recording = load("drop.csv", quaternion_order="xyzw", length_unit="m")

A log that cannot be used is refused with one sentence that names file, line and cause. No sample is invented:
what a loader left out, kept or changed is in `Recording.provenance.notes`.

Notes
-----
Each format is one small module (`rcbenchmark_csv`, `vicon_csv`, `tdms`, ...; `formats()` lists them) with one
line in `sysid.loaders.registry`; other packages add theirs through the entry-point group ``sysid.loaders``.
Libraries that only one format needs come with the extra ``logs``.
"""

from sysid.loaders.registry import LogFormat, detect, formats, load

__all__ = ["LogFormat", "detect", "formats", "load"]
