"""Parameter sets as files for simulators: JSON, CSV, HDF5 and MAT, each read back to equal values.

Every format carries the same: ranked sets, each parameter with name, symbol, unit, bounds, scale, status,
at-bound flag, meaning and source, every value that was not searched, settings, NRMSE per trial and channel,
provenance, and a schema version. Reading decides by content, not by suffix, and refuses what is foreign,
cut off or of another version with one sentence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sysid.errors import ExportError, FitError, SysidError
from sysid.export import binary, spreadsheet
from sysid.fit.result import FitResult
from sysid.fit.store import FIT_FILE, read_fit, read_sets
from sysid.gear.parameters import PARAMETERS as OF_GEAR
from sysid.motor.parameters import PARAMETERS as OF_MOTOR
from sysid.parameter_sets import ParameterSets, SetsContent, SetsDocument
from sysid.storage import path_of, schema_of, write_file
from sysid.trust.documents import with_intervals

__all__ = ["SUFFIXES", "export", "load_parameter_sets", "read_judged_fit"]


_WRITERS = {
    ".json": lambda sets: sets.document().text().encode("utf-8"),
    ".csv": spreadsheet.to_csv,
    ".h5": binary.to_hdf5,
    ".mat": binary.to_mat,
}
SUFFIXES = tuple(_WRITERS)


def export(sets: ParameterSets, path: str | Path) -> Path:
    """Write ranked parameter sets in the format that the suffix of `path` names, and return the path.

    The suffix is ``.json``, ``.csv``, ``.h5`` or ``.mat``. An existing file is replaced, and only once the
    new one is complete. ExportError for another suffix, and when the file cannot be written.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ExportError(
            f"{path}: unknown export format {path.suffix!r}; expected one of {', '.join(SUFFIXES)}, or on "
            "the command line .xml (MuJoCo) or .sdf (Gazebo)"
        )
    write_file(path, writer(sets), ExportError)
    return path


def load_parameter_sets(path: str | Path) -> ParameterSets:
    """Read parameter sets from any file that `export` writes, or from a fit folder or a file of it.

    They are equal to what was written, bit for bit; sets of a fit state its intervals. ExportError when
    there is no file, it is foreign, damaged, cut off or of an unknown schema version, FitError for such a
    fit, and where its files contradict each other.
    """
    file = path_of(path, "a fit or a file of sets")
    # A fit has one truth, whichever of its files is named.
    beside = file.with_name("fit.h5")
    of_fit = file.name in ("fit.h5", "fit.json") and beside.is_file()
    folder = file.parent if of_fit else file
    missing = not (file.suffix or file.exists())
    if file.is_dir() or missing or (of_fit and schema_of(beside, ExportError) == FIT_FILE.schema):
        sets = with_intervals(read_sets(folder), folder)
        _judge(sets, folder)
        return sets
    try:
        data = file.read_bytes()
    except OSError as error:
        refusal = ExportError(f"{file}: cannot be read ({error.strerror}); expected a parameter-set file")
        raise refusal.also(type(error)) from error
    text = data[3:] if data.startswith(b"\xef\xbb\xbf") else data
    try:
        if data.startswith(binary.HDF5_SIGNATURE):
            sets = binary.from_hdf5(data, file)
        elif data.startswith(binary.MAT_SIGNATURE):
            sets = binary.from_mat(data, file)
        elif text.lstrip()[:1] == b"{":
            document = SetsDocument.parse(data.decode("utf-8-sig"), file, ExportError)
            sets = ParameterSets.from_document(document)
        elif text.startswith(spreadsheet.SIGNATURE):
            sets = spreadsheet.from_csv(data, file)
        elif text.startswith(spreadsheet.DRAWN):
            raise ExportError(f"{file}: a table of draws, for other programs; export them to .json for sysid")
        else:
            raise ExportError(
                f"{file}: neither JSON, CSV, HDF5 nor MAT of sysid; expected a file that sysid export wrote"
            )
    # Everything that a damaged file can make the libraries and the checks above raise.
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OSError, EOFError) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise ExportError(f"{file}: damaged or cut off ({first}); export the fit again") from error
    if not len(sets):
        raise ExportError(f"{file}: a parameter-set file without sets; export the fit again")
    _judge(sets, file, "correct it, or export the fit again", ExportError)
    return sets


def read_judged_fit(path: str | Path) -> FitResult:
    """Read a fit folder, or its ``fit.h5``, and judge its sets.

    Raises FitError where `read_fit` does, or the table of the fit's model excludes a unit or a value.
    """
    result = read_fit(path)
    _judge(result, path)
    return result


def _judge(
    sets: SetsContent, file: str | Path, remedy: str = "restore fit.h5, or run the fit again",
    error_type: type[SysidError] = FitError,
) -> None:  # fmt: skip
    """Refuse units and values that the table of the sets' model excludes.

    NaN is a number that nothing determined; what needs it refuses it.
    """
    table = {"motor": OF_MOTOR, "gear": OF_GEAR}.get(sets.kind)
    for i, record in enumerate(sets.parameters):
        row = table.get(record.name.partition("[")[0]) if table else None
        if row is None:
            continue
        if record.unit != row.unit:
            raise error_type(
                f"{file}: {record.name} has the unit {record.unit!r}, expected {row.unit!r}; {remedy}"
            )
        # A scale of ratios has no zero: masses, inertias, stiffnesses, resistances.
        least, above = (0.0, " above 0") if row.scale == "log" else (-np.inf, "")
        values = sets.values[:, i]
        # A motor without saturation has an infinite current there.
        high = np.isposinf(values) & (row.name != "saturation_current")
        if (wrong := np.flatnonzero((values <= least) | high)).size:
            raise error_type(
                f"{file}: {record.name} of set {wrong[0] + 1} is {values[wrong[0]]:g} {row.unit}, expected "
                f"a finite number{above}; {remedy}"
            )
