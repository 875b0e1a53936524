"""A row that lost one cell: its numbers are missing or the log is refused; none moves to another column."""

import numpy as np
import pytest

from fakes.log_files import notes
from fakes.log_samples import LOGS, Log
from sysid.errors import SysidError
from sysid.loaders import load
from sysid.loaders.columns import table_head
from sysid.loaders.source import Source, read_text
from sysid.loaders.table import read_numbers


def unneeded_end():
    """A Motive export whose last column, an error, no fit needs, and whose rows end with a comma."""
    head, *rows = LOGS["motive-csv"].data.decode("utf-8").partition("Frame,Time")
    columns = "".join(rows).split("\r\n")
    kept = [",".join(line.split(",")[:10]) + "," if line else line for line in columns]
    return (head + "\r\n".join(kept)).encode("utf-8")


SAMPLES = dict(LOGS) | {"motive-csv, the end not needed": Log(unneeded_end(), ",", 6, 7)}


def values(recording):
    """Values of every channel by time to the nanosecond."""
    return {
        (name, round(float(time) * 1e9)): row
        for name, channel in recording.channels.items()
        for time, row in zip(channel.time, channel.values, strict=True)
    }


@pytest.mark.parametrize("name", SAMPLES)
def test_a_row_without_one_of_its_cells_gives_no_number_to_another_column(tmp_path, name):
    log, path, form = SAMPLES[name], tmp_path / "log.csv", name.partition(",")[0]
    path.write_bytes(log.data)
    whole = values(load(path, format=form, **log.options))
    lines = log.data.decode("utf-8").split("\n")
    read = 0
    for at in (log.first + 11, len(lines) - 8):
        end = "\r" * lines[at].endswith("\r")
        cells = lines[at].removesuffix("\r").split(log.delimiter)
        for gone in range(len(cells)):
            row = log.delimiter.join(cells[:gone] + cells[gone + 1 :]) + end
            path.write_text("\n".join([*lines[:at], row, *lines[at + 1 :]]), encoding="utf-8", newline="")
            try:
                damaged = load(path, format=form, **log.options)
            except SysidError:
                continue
            read += 1
            for key, row_values in values(damaged).items():
                same = np.isnan(row_values) | np.isclose(row_values, whole.get(key, np.nan), equal_nan=True)
                assert np.all(same), f"without cell {gone + 1} of line {at + 1}, {key}: {notes(damaged)}"
    # A table is not refused for a row; ROS and Net F/T have words in their rows.
    assert read or form == "net-ft-csv"


@pytest.mark.parametrize(("every", "missing"), [(4, False), (60, True)])
def test_rows_that_a_program_ends_before_their_blank_cells_are_whole(tmp_path, every, missing):
    """Where a quarter of the rows lacks the last cell, it is a habit; a single row has lost one."""
    rows = (f"{i},7" + ("" if i % every == 1 else ",") for i in range(60))
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["a,b,c", *rows, ""]), encoding="utf-8")
    text = read_text(Source(path))
    numbers = read_numbers(text, table_head(text), [0, 1], least=2)
    assert np.isnan(numbers.columns[1]).sum() == missing
    assert [finding.code for finding in numbers.notes] == ["short-rows"] * missing
