"""Parameter sets as HDF5 and MATLAB files.

Arrays are native datasets and matrices; texts, records and settings are one exact JSON text next to
them (``metadata_json``), which is what sysid reads. Copies of it in native form (names, units, bounds,
95 % intervals and verdicts; in MATLAB also one structure per set) are for other readers. An open end of an
interval is infinite; the end and the verdict of what was not judged are NaN and empty.
"""

import io
import json
import re
import zlib
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sysid.errors import ExportError
from sysid.parameter_sets import ParameterSets, SetsMetadata, interval_columns
from sysid.storage import FileKind, get_texts, put, put_texts
from sysid.types import FloatArray

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MAT_SIGNATURE = b"MATLAB 5.0 MAT-file"
_FILE = FileKind("sysid-parameter-sets", 1, SetsMetadata.WHAT, SetsMetadata.REMEDY, ExportError)
_COLUMNS = ("name", "symbol", "unit", "status", "scale", "meaning", "source")
_NUMBERS = ("nominal", "lower", "upper")
_ARRAYS = ("values", "nrmse", "at_bound", "nrmse_by_trial")


def _records(sets: ParameterSets) -> dict[str, NDArray[np.object_] | FloatArray]:
    texts = {
        key: np.array([getattr(r, key) or "" for r in sets.parameters], dtype=object) for key in _COLUMNS
    }
    # None becomes NaN.
    numbers = {key: np.array([getattr(r, key) for r in sets.parameters], np.float64) for key in _NUMBERS}
    if sets.judged:
        rows = [interval_columns(row.judged) for row in sets.known.values()]
        texts["verdict"] = np.array([row.pop("verdict") for row in rows], dtype=object)
        numbers |= {key: np.array([row[key] for row in rows], np.float64) for key in rows[0]}
    return texts | numbers


def to_hdf5(sets: ParameterSets) -> bytes:
    """Return the file."""
    metadata = sets.metadata()

    def write(file: h5py.File) -> None:
        file.attrs["kind"] = sets.kind
        put(file, "values", sets.values, "set (best first), parameter", "in parameters/unit")
        put(file, "nrmse", sets.nrmse, "set")
        put(file, "nrmse_by_trial", sets.nrmse_by_trial, "set, trial, channel")
        put(file, "at_bound", sets.at_bound, "set, parameter: -1 lower bound, +1 upper bound")
        for key, column in _records(sets).items():
            if column.dtype == np.float64:
                put(file, f"parameters/{key}", column, "parameter", "its unit")
            else:
                put_texts(file, f"parameters/{key}", map(_no_nul, column))
        put_texts(file, "trials", map(_no_nul, sets.trials))
        put_texts(file, "channels", map(_no_nul, sets.channels))
        put_texts(file, "metadata_json", metadata.line())

    return _FILE.content(write)


def _no_nul(text: str) -> str:
    # HDF5 ends its texts at the first NUL; the exact text is in metadata_json.
    return text.replace("\0", "")


def from_hdf5(data: bytes, place: Path) -> ParameterSets:
    """Return the sets of a file that `to_hdf5` wrote; any other exception than ExportError means damage."""
    with _FILE.opened(place, data) as file:
        metadata = SetsMetadata.parse(get_texts(file, "metadata_json"), place, ExportError)
        return _assembled(metadata, {key: file[key][()] for key in _ARRAYS if key in file})


def _assembled(metadata: SetsMetadata, arrays: dict[str, FloatArray]) -> ParameterSets:
    missing = {*_ARRAYS} - {*arrays}
    if missing:
        raise ValueError(f"{', '.join(sorted(missing))} missing")
    values, nrmse, by_trial = (arrays[key] for key in ("values", "nrmse", "nrmse_by_trial"))
    return ParameterSets.from_metadata(metadata, values, nrmse, arrays["at_bound"].astype(np.int8), by_trial)


def _field_names(names: tuple[str, ...]) -> dict[str, str]:
    """Return a valid and distinct MATLAB field name (letters, digits, _; 63 at most) for every name."""
    out: dict[str, str] = {}
    for name in names:
        base = re.sub(r"[^A-Za-z0-9_]", "_", name)
        base = (base if re.match(r"[A-Za-z]", base) else f"x_{base}")[:63]
        field, count = base, 1
        while field in out.values():
            count += 1
            field = f"{base[:59]}_{count}"
        out[name] = field
    return out


def to_mat(sets: ParameterSets) -> bytes:
    """Return the file: one structure ``sysid`` whose ``sets(1)`` is the best set, by parameter name."""
    fields = _field_names(sets.names)
    by_set = np.empty((1, len(sets)), dtype=[(field, object) for field in fields.values()])
    for s in range(len(sets)):
        for i, name in enumerate(sets.names):
            by_set[0, s][fields[name]] = sets.values[s, i]
    metadata = sets.metadata()
    content: dict[str, object] = {
        "schema": metadata.schema_,
        "version": float(metadata.version),
        "kind": sets.kind,
        "name": sets.name,
        "sets": by_set,
        "parameters": {**_records(sets), "field": np.array(list(fields.values()), dtype=object)},
        "trials": np.array(sets.trials, dtype=object),
        "channels": np.array(sets.channels, dtype=object),
        "values": sets.values,
        "nrmse": sets.nrmse,
        "at_bound": sets.at_bound.astype(np.float64),
        "nrmse_by_trial": sets.nrmse_by_trial,
        # Plain ASCII: MATLAB does not store text as UTF-8.
        "metadata_json": json.dumps(json.loads(metadata.line())),
    }
    from scipy.io import savemat  # takes as long to import as all else that `sysid show` needs

    stream = io.BytesIO()
    # scipy's stubs know paths only.
    savemat(stream, {"sysid": content}, long_field_names=True, do_compression=True, oned_as="row")  # type: ignore[arg-type]
    return stream.getvalue()


def from_mat(data: bytes, place: object) -> ParameterSets:
    """Return the sets of a file that `to_mat` wrote; any other exception than ExportError means damage."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        variables = loadmat(io.BytesIO(data), squeeze_me=False)  # type: ignore[arg-type]
    except (MatReadError, zlib.error) as error:
        raise ValueError(str(error)) from error
    record = variables.get("sysid", np.empty(()))
    content = {name: record[name][0, 0] for name in record.dtype.names or ()}
    text = str(content["metadata_json"].item()) if "metadata_json" in content else "{}"
    metadata = SetsMetadata.parse(text, place, ExportError)
    arrays = {key: np.asarray(content[key], np.float64) for key in _ARRAYS if key in content}
    # MATLAB makes a matrix of a row, and drops a last axis of one.
    arrays["nrmse"] = arrays["nrmse"].reshape(len(metadata.runs))
    shape = len(metadata.runs), len(metadata.trials), len(metadata.channels)
    arrays["nrmse_by_trial"] = arrays["nrmse_by_trial"].reshape(shape)
    return _assembled(metadata, arrays)
