"""Parameter sets as one CSV table that a spreadsheet opens and sysid reads back.

One header, one row per thing: ``about`` rows carry what is not a table as JSON in the column `meaning`,
``parameter`` rows the sets in columns ``set_1 …`` (best first), ``nrmse`` rows the mean and the NRMSE of
each trial (`name`) and channel (`symbol`). The last row counts the rows before it, so a cut file shows.
Draws are a table of their own, for other programs: a row per draw, a column per number [SI].
"""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from sysid import exact_json
from sysid.errors import ExportError
from sysid.parameter_sets import DRAWS, ParameterSets, SetsMetadata, interval_columns

SIGNATURE = b"row,name,symbol,unit,status,"
DRAWN = b"draw,"
# A spreadsheet takes a text that begins so for a formula; an apostrophe is doubled, to be read back.
_COMPUTED = ("=", "+", "-", "@", "\t", "\r", "'")
_FIXED = ("row", "name", "symbol", "unit", "status", "lower", "upper", "scale", "nominal", "mean", "sigma")
_TEXTS = ("name", "symbol", "unit", "status", "meaning", "source", "group", "trial")
_NUMBERS = ("lower", "upper", "nominal", "stated_sigma")
# Columns for people; the settings state the same.
_INTERVAL = ("interval_low", "interval_high", "verdict")
_RECORD = (*_TEXTS, *_NUMBERS, "scale")


def to_csv(sets: ParameterSets) -> bytes:
    """Return the file; UTF-8 with the mark that lets spreadsheets show Ω and µ."""
    if DRAWS in sets.provenance:
        heads = [f"{row.name} [{row.unit}]" for row in sets.parameters]
        draws = enumerate(sets.values.tolist(), start=1)
        table = [{"draw": k} | dict(zip(heads, row, strict=True)) for k, row in draws]
        return csv_text(table, line_end="\r\n").encode("utf-8-sig")
    n_sets = len(sets)
    columns = [
        *_FIXED, *(f"set_{s + 1}" for s in range(n_sets)), *(f"at_bound_{s + 1}" for s in range(n_sets)),
        *_INTERVAL, "measured_low", "measured_high", "stated_sigma", "meaning", "source", "group", "trial",
    ]  # fmt: skip
    metadata = sets.metadata().model_dump(exclude={"parameters"})
    rows: list[dict[str, object]] = [
        {"row": "about", "name": key, "meaning": exact_json.dumps(value, indent=None)}
        for key, value in metadata.items()
    ]
    for known in sets.known.values():
        row: dict[str, object] = {key: getattr(known.record, key) for key in _RECORD}
        row |= {"row": "parameter", "mean": known.mean, "sigma": known.sigma}
        if known.record.measured_range is not None:
            row["measured_low"], row["measured_high"] = known.record.measured_range
        if known.judged:
            # The cell of an open end is empty: a bound of the search is no end.
            cells = interval_columns(known.judged).items()
            row |= {key: None if cell in (-math.inf, math.inf) else cell for key, cell in cells}
        row |= {f"at_bound_{s + 1}": int(flag) for s, flag in enumerate(known.at_bound)}
        rows.append(row | _by_set(known.values))
    rows.append({"row": "nrmse_mean", "unit": "1"} | _by_set(sets.nrmse))
    for t, trial in enumerate(sets.trials):
        for c, channel in enumerate(sets.channels):
            row = {"row": "nrmse", "name": trial, "symbol": channel, "unit": "1", "status": sets.uses[t]}
            rows.append(row | _by_set(sets.nrmse_by_trial[:, t, c]))
    rows.append({"row": "end", "name": str(len(rows))})
    return csv_text(rows, columns, line_end="\r\n").encode("utf-8-sig")


def csv_text(
    rows: Sequence[Mapping[str, object]], columns: Sequence[str] | None = None, *, line_end: str = "\n"
) -> str:
    """Return rows as CSV under the given columns, by default the keys of the first row.

    None is an empty cell; a float is the shortest text that reads back to the same float. A text that a
    spreadsheet would compute gets a leading apostrophe.
    """
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, columns or list(rows[0]), restval="", lineterminator=line_end)
    writer.writeheader()
    for row in rows:
        inert = {
            key: f"'{cell}" if isinstance(cell, str) and cell.startswith(_COMPUTED) else cell
            for key, cell in row.items()
        }
        writer.writerow(inert)
    return stream.getvalue()


def _by_set(values: Iterable[float]) -> dict[str, object]:
    return {f"set_{s + 1}": float(value) for s, value in enumerate(values)}


def _number(cell: str) -> float | None:
    return None if cell == "" else float(cell)


def from_csv(data: bytes, place: object) -> ParameterSets:
    """Return the sets of a file that `to_csv` wrote; any other exception than ExportError means damage."""
    rows = _rows(data.decode("utf-8-sig"))
    if not rows or rows[-1]["row"] != "end" or rows[-1]["name"] != str(len(rows) - 1):
        raise ValueError("the last row, which counts the others, is missing or disagrees")
    if any(None in row or None in row.values() for row in rows):
        raise ValueError("a row has more or fewer cells than the header")
    metadata: dict[str, object] = {
        row["name"]: exact_json.loads(row["meaning"]) for row in rows if row["row"] == "about"
    }
    parameters = [row for row in rows if row["row"] == "parameter"]
    metadata["parameters"] = [_record(row) for row in parameters]
    checked = SetsMetadata.of(metadata, place, ExportError)
    ranks = range(1, len(checked.runs) + 1)
    names, flags = [f"set_{rank}" for rank in ranks], [f"at_bound_{rank}" for rank in ranks]
    scores = {
        (row["name"], row["symbol"]): [float(row[n]) for n in names] for row in rows if row["row"] == "nrmse"
    }
    by_trial = np.empty((len(names), len(checked.trials), len(checked.channels)))
    for t, trial in enumerate(checked.trials):
        for c, channel in enumerate(checked.channels):
            by_trial[:, t, c] = scores[trial.name, channel.name]
    (mean,) = (row for row in rows if row["row"] == "nrmse_mean")
    return ParameterSets.from_metadata(
        checked,
        values=np.array([[float(row[n]) for row in parameters] for n in names]),
        nrmse=np.array([float(mean[n]) for n in names]),
        at_bound=np.array([[int(row[n]) for row in parameters] for n in flags], dtype=np.int8),
        nrmse_by_trial=by_trial,
    )


def _rows(text: str) -> list[dict[str, str]]:
    # A cell of settings may be longer than the csv module's default limit, which is global to the process.
    limit = csv.field_size_limit(max(len(text), csv.field_size_limit()))
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    except csv.Error as error:
        raise ValueError(str(error)) from error
    finally:
        csv.field_size_limit(limit)
    # A row of more or fewer cells than the header has a list or None in it.
    return [{k: c[1:] if isinstance(c, str) and c[:1] == "'" else c for k, c in row.items()} for row in rows]


def _record(row: dict[str, str]) -> dict[str, object]:
    # Files of earlier versions have neither group nor trial.
    record: dict[str, object] = {key: row.get(key, "") for key in _TEXTS}
    record |= {key: _number(row[key]) for key in _NUMBERS}
    record["scale"] = row["scale"] or None
    low, high = _number(row["measured_low"]), _number(row["measured_high"])
    record["measured_range"] = None if low is None or high is None else (low, high)
    return record
