"""Rows whose numbers are not below their names: a delimiter too many or one lost, in a row or the header."""

import numpy as np
import pytest

from fakes.log_files import refuses
from sysid.loaders import load

NAMES = "Time (s),ESC signal (µs),Torque (N·m),Thrust (N),Voltage (V),App message,"
ROWS = [f"{0.01 * i:.2f},{1000 + i},0.5,{2 + i},16," for i in range(20)]


@pytest.fixture
def stand(write):
    return lambda rows, names=NAMES: write("\n".join([names, *rows, ""]), "log.csv")


def changed(**rows):
    """Return the rows, some of them (`line_7` is that of line 7) replaced."""
    out = [row + "," for row in ROWS]
    for name, row in rows.items():
        out[int(name.removeprefix("line_")) - 2] = row
    return out


@pytest.mark.parametrize("place", [1, 2, 3, 4])
def test_a_delimiter_too_many_leaves_the_row_out(stand, place):
    cells = (ROWS[5] + ",").split(",")
    row = ",".join([*cells[:place], "", *cells[place:]])
    log = load(stand(changed(line_7=row)))
    assert any("cell too many" in note and "line 7" in note for note in log.provenance.sentences)
    # 5: the time is not below its name either, so the row has no place in the log.
    np.testing.assert_array_equal(log["thrust"].values, np.delete(2.0 + np.arange(20), 5))
    np.testing.assert_array_equal(log["thrust"].time, np.delete(np.arange(20) / 100, 5))


def test_a_delimiter_lost_leaves_the_row_out(stand):
    row = "0.05,10050.5,7,16,,"
    log = load(stand(changed(line_7=row)))
    assert any("fewer than 7 cells" in note and "line 7" in note for note in log.provenance.sentences)
    np.testing.assert_array_equal(log["thrust"].values, np.delete(2.0 + np.arange(20), 5))


def test_words_may_hold_delimiters_and_scripts_append_cells(stand):
    names = NAMES + "90% settling time (s),Max acceleration (RPM/s),"
    rows = changed(
        line_3="0.01,1001,0.5,3,16,cut off, motor hot, stopped,,,,", line_9="0.07,1007,0.5,9,16,,0.2,900,"
    )
    log = load(stand(rows, names))
    np.testing.assert_array_equal(log["thrust"].values, 2.0 + np.arange(20))
    assert not any("cell" in note for note in log.provenance.sentences)


def test_a_header_that_lost_a_name_is_refused(stand):
    path = stand(changed(), NAMES.replace("Torque (N·m),", ""))
    refuses(path, r"log\.csv, line 2: 7 cells where the header has 6, as in most rows")


def test_rows_that_lost_a_column_are_refused(stand):
    rows = [row.replace(",0.5", "").rstrip(",") for row in changed()]
    refuses(stand(rows), r"line 2: 4 cells where 7 are expected, as in most rows")


def test_a_table_without_words_of_its_own(write):
    rows = [f"{1e-3 * i:.3f},{i},0.5," for i in range(20)]
    rows[4] = "0.004,,4,,"  # blank at the end: nothing stands beyond the header, and yet 4 is no torque
    path = write("\n".join(["t (s),Fz (N),Mz (N·m),", *rows, ""]), "log.csv")
    log = load(path)
    assert log["torque"].values.size == 19
    assert np.all(log["torque"].values == 0.5)


def test_a_number_among_the_remarks_of_labview(write):
    head = ["LabVIEW Measurement", "Separator\tTab", "X_Columns\tOne", "***End_of_Header***", ""]
    head += ["Channels\t2\t", "Y_Unit_Label\tN\tN*m\t", "***End_of_Header***\t\t", "X_Value\tFz\tMz\tComment"]
    rows = [f"{0.001 * i:.3f}\t{i}\t0.5" for i in range(20)]
    rows[4] = "0.004\t\t4\t0.5"  # shifted
    rows[6] += "\t2"  # a remark: all its numbers are there
    path = write("\n".join([*head, *rows, ""]), "log.lvm")
    log = load(path)
    np.testing.assert_array_equal(log["thrust"].values, np.delete(np.arange(20.0), 4))


def test_short_rows_of_a_lost_body_do_not_make_the_whole_ones_long(write):
    head = ["Objects", "100", ",,Global Angle (Quaternion) quad:quad,,,,,,,"]
    head += ["Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ,", ",,,,,,mm,mm,mm,"]
    rows = [f"{i + 1},0," + ("0.6,0,0,0.8,1,2,3," if i < 15 else "") for i in range(20)]
    rows[6:15] = [f"{i + 1},0," for i in range(6, 15)]
    path = write(
        "\n".join([*head, *(row + ",,,,,," * (i > 14) for i, row in enumerate(rows)), ""]), "log.csv"
    )
    # 9 rows of 3 cells are the most usual ones; 6 have 10 cells and 5, blank ones, 9.
    assert load(path)["quad/position"].valid.sum() == 6


def test_words_among_the_settings_of_ati_are_refused(write):
    head = ["First line indicates sampling freq [Hz], samples per channel", "Fx, Fy, Fz, Mx, My, Mz"]
    path = write("\n".join([*head, "150,75,500,x#.2,-0.5,-0.3,-0.5", *["1,2,3,4,5,6"] * 5, ""]), "log.csv")
    units = {"force": "N", "torque": "N*m"}
    refuses(path, r"line 3: 'x#\.2' is no number in the line that states the rate", units=units)
