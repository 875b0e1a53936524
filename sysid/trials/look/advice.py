"""What to do about a wrong unit: an option that the format of the log takes, else the place to correct."""

from __future__ import annotations

from sysid.loaders.registry import formats
from sysid.recording import Recording

# Formats whose files state a length unit, which a declared one must not contradict.
_STATES_LENGTHS = frozenset({"motive-csv", "pose-table", "vicon-csv", "c3d"})


def _mend(recording: Recording, option: str) -> str:
    """Return where to correct the unit if the file's format has no `option`; empty if it has."""
    provenance = recording.provenance
    if any(finding.code == "converted" for finding in provenance.notes[-1:]):
        return "convert the original log again with its true unit"
    known = formats().get(provenance.format)
    if known is None or option not in known.options:
        return "correct it where the log was written, or in its header"
    return ""


def unit_advice(recording: Recording, channel: str, unit: str) -> str:
    """Return how to say the unit that the speed, thrust or torque of a bench log is probably in.

    The recording's format and options decide.
    """
    mend = _mend(recording, "units")
    if mend:
        return mend
    provenance = recording.provenance
    if channel == "speed" and "pulses_per_revolution" in provenance.options:
        return "check pulses_per_revolution"
    if provenance.format == "ati-text":  # six channels by place share two units
        if "calibration" in provenance.options:
            return "check that the calibration belongs to this transducer"
        return f'correct {"torque" if channel == "torque" else "force"} = "{unit}" in units'
    return f'declare units = {{{channel} = "{unit}"}}'


def length_advice(recording: Recording, unit: str) -> str:
    """Return how to say the length unit of a capture, as `unit_advice`."""
    mend = _mend(recording, "length_unit")
    if mend:
        return mend
    provenance = recording.provenance
    if provenance.format in _STATES_LENGTHS and "length_unit" not in provenance.options:
        if provenance.format == "pose-table":
            return f'declare units = {{x = "{unit}", y = "{unit}", z = "{unit}"}}'
        return "the file states its length unit, so correct it there or export again"
    return f'declare length_unit = "{unit}"'
