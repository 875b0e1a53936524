"""Text tables: encodings, delimiters, two ways of reading numbers that agree, cells not below their names."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fakes.log_files import notes, refuses
from sysid.errors import LogError, UnitError
from sysid.loaders import load, table
from sysid.loaders.clock import jitter_note
from sysid.loaders.columns import split_label, table_head
from sysid.loaders.source import Source, read_text
from sysid.loaders.table import read_numbers


def numbers_of(path, wanted=None, **options):
    text = read_text(Source(path))
    head = table_head(text)
    return read_numbers(text, head, range(len(head.names)) if wanted is None else wanted, **options)


def test_broken_utf16_and_nul(write):
    with pytest.raises(LogError, match=r"marked as UTF-16 but broken"):
        read_text(Source(write("a,b\n".encode("utf-16") + b"\x00")))
    with pytest.raises(LogError, match=r"line 2: NUL byte"):
        read_text(Source(write(b"a,b\n1,\x002\n")))
    # Without a mark, UTF-16 shows in every other byte.
    assert read_text(Source(write("a,b\n1,2\n".encode("utf-16-le")))).data == b"a,b\n1,2\n"
    with pytest.raises(LogError, match=r"line 1: NUL byte"):
        read_text(Source(write("a,b\n1,2\n".encode("utf-16-le") + b"\x00")))


NAN = np.nan


@pytest.mark.parametrize(("content", "lines", "columns", "said"), [
    # A quote never runs past its line; comments and blank lines are counted.
    ('a,b\n1,"2\n3,4\n', [2, 3], [[1, 3], [2, 4]], ()),
    ("\n# by hand\na,b\n1,2\n\n# note, with, commas\n 3 ,4\n\n# end\n", [4, 7], [[1, 3], [2, 4]], ()),
    # A short row is missing, and a cut last line is left out; one without its end alone is kept.
    ("a,b,c\n1,2,3\n4,5\n6,7,8\n9,1", [2, 3, 4], [[1, NAN, 6], [2, NAN, 7], [3, NAN, 8]],
     ("line 5, the last, is cut", "rows with fewer than 3 cells: 1 (first: line 3)")),
    ("a,b\n1,2\n3,4", [2, 3], [[1, 3], [2, 4]],
     ("line 3, the last, has no line end: its last number may be cut",)),
    ("a,b\n1,inf\n1e999,4\n", [2, 3], [[1, NAN], [NAN, 4]], ("infinite number: 2",)),
])  # fmt: skip
def test_rows_of_a_table(write, content, lines, columns, said):
    numbers = numbers_of(write(content))
    np.testing.assert_array_equal(numbers.lines, lines)
    np.testing.assert_array_equal(numbers.stacked(numbers.columns).T, columns)
    assert numbers.open_end == any("may be cut" in words for words in said)
    for words in said:
        assert any(words in str(note) for note in numbers.notes)


@pytest.mark.parametrize("count", [0, 199, 200, 700])
def test_decimal_comma_only_where_no_point_is_however_late(write, count):
    # A stand at rest writes whole numbers for longer than any first look reaches.
    numbers = numbers_of(write("a;b\n" + "0;0\n" * count + "1,5;2\n3;4,25\n"))
    np.testing.assert_array_equal(numbers.columns[1][-2:], [2, 4.25])
    with pytest.raises(LogError, match="'1,5' in column 'a' is not a number"):
        numbers_of(write("a;b\n" + "0;0\n" * count + "1,5;2.5\n"))


@pytest.mark.parametrize(
    "cell", ["1_0", "0x1", "1d5", "1e", ".", "-", "1.2.3", "TRUE", "1 2", "٣", "--1", "NA", "1f"]
)
def test_what_is_no_number_is_refused_by_both_readers(write, cell, monkeypatch):
    path = write(f"a,b\n1,2\n{cell},3\n")
    for small in (table._SMALL, -1):
        monkeypatch.setattr(table, "_SMALL", small)
        with pytest.raises(LogError, match=r"line 3: .* in column 'a' is not a number"):
            numbers_of(path)


@pytest.mark.parametrize("cell", ["+1", "5.", ".5", "1E-5", " 1 ", "nan", "NaN", "", " ", "1e-400", '"1"'])
def test_what_is_a_number_is_the_same_for_both_readers(write, cell, monkeypatch):
    path = write(f"a,b\n1,2\n{cell},3\n")
    slow = numbers_of(path).columns
    monkeypatch.setattr(table, "_SMALL", -1)
    fast = numbers_of(path).columns
    for index in fast:
        np.testing.assert_array_equal(fast[index], slow[index])


@pytest.mark.parametrize(("label", "stem", "unit"), [
    ("Thrust (gf)", "thrust", "gf"),
    ("x [mm]", "x", "mm"),
    ("px_m", "px", "m"),
    ("wx_rad_s", "wx", "rad/s"),
    ("t_s", "t", "s"),
    ("p_RS_R_x [m]", "p rs r x", "m"),
    ("q_RS_w []", "q rs w", ""),
    ("ESC signal", "esc signal", None),
    ("qx", "qx", None),
    ("Thrust_N", "thrust", "N"),
    ("Motor  Optical Speed (RPM) ", "motor optical speed", "RPM"),
])  # fmt: skip
def test_labels(label, stem, unit):
    assert split_label(label)[:2] == (stem, unit)


def test_jitter_is_said_only_where_it_is():
    steady = np.arange(100) / 200.0
    assert jitter_note(steady) == []
    # A missing frame is a gap, not jitter.
    assert jitter_note(np.delete(steady, 50)) == []
    [finding] = jitter_note(steady + np.random.default_rng(0).uniform(0, 2e-3, 100))
    assert finding.code == "unsteady-clock"


def test_the_hash_is_of_the_bytes_that_were_read(write):
    path = write("a,b\n1,2\n")
    text, library, gone = Source(path), Source(path), Source(path)
    text.read_bytes()
    before = text.sha256
    path.write_text("a,b\n1,3\n", encoding="utf-8")
    assert text.sha256 == before
    # A library that reads the file itself leaves only the file to be hashed.
    with pytest.raises(LogError, match="changed while it was read; try again when it is written"):
        _ = library.sha256
    path.unlink()
    with pytest.raises(LogError, match="changed while it was read"):
        _ = gone.sha256


STAMPED = "Time (UTC),Fz (N),Mz (N·m)\n"


def stamped(stamp="2026-11-22T10:59:59.{:03d}Z", mark=","):
    return "".join(f"{stamp.format(10 * i)}{mark}{i}{mark}5\n" for i in range(50))


@pytest.mark.parametrize(("head", "rows"), [
    (STAMPED, stamped()),
    (STAMPED, stamped("2026-11-22 10:59:59.{:03d}")),
    (STAMPED, stamped('"2026-11-22T10:59:59.{:03d}000+02:00"')),
    (STAMPED.replace(",", ";"), stamped("2026-11-22T10:59:59,{:03d}", ";")),
    ("Time Fz[N] Mz[N*m] RPM\n", stamped().replace(",", "   ").replace("\n", " 7\n")),
])  # fmt: skip
def test_times_by_iso_8601_count_from_the_first(write, head, rows):
    log = load(write(head + rows, "log.csv"))
    np.testing.assert_allclose(log["thrust"].time, np.arange(50) * 0.01, atol=1e-9)
    np.testing.assert_array_equal(log["thrust"].values, np.arange(50.0))
    assert "has ISO 8601 times: counted from 2026-11-22" in notes(log)


def clock_times(pattern, begin, mark=","):
    """Rows of 10 ms with times of day from `begin` [ms], written by `pattern` of h, m, s, ms and the half."""
    rows = []
    for i in range(50):
        day, ms = divmod(begin + 10 * i, 86_400_000)
        hour, minute, second = ms // 3_600_000, ms // 60_000 % 60, ms // 1000 % 60
        stamp = pattern.format(
            h=hour,
            m=minute,
            s=second,
            ms=ms % 1000,
            d=5 + day,
            half="AP"[hour // 12],
            h12=(hour - 1) % 12 + 1,
        )
        rows.append(f"{stamp}{mark}{i}{mark}5\n")
    return "".join(rows)


@pytest.mark.parametrize("begin", [62_048_947, 86_399_800], ids=["afternoon", "past midnight"])
@pytest.mark.parametrize("pattern", [
    "{h:02}:{m:02}:{s:02}:{ms:03}", "{h}:{m:02}:{s:02}.{ms:03}", '"{h:02}:{m:02}:{s:02}.{ms:03}000"',
    "2019-11-{d:02} {h:02}:{m:02}:{s:02}:{ms:03}", "2019-11-{d:02}T{h:02}:{m:02}:{s:02}.{ms:03}",
    "11/{d}/2019 {h12}:{m:02}:{s:02}.{ms:03} {half}M", "{d}.11.2019 {h:02}:{m:02}:{s:02}.{ms:03}",
])  # fmt: skip
def test_clock_times_count_from_the_first(write, pattern, begin):
    log = load(write(STAMPED + clock_times(pattern, begin), "log.csv"))
    np.testing.assert_allclose(log["thrust"].time, np.arange(50) * 0.01, atol=1e-9)
    np.testing.assert_array_equal(log["thrust"].values, np.arange(50.0))
    assert "counted from " in notes(log)


def test_times_of_day_that_are_none_are_refused(write):
    rows = clock_times("{h:02}:{m:02}:{s:02}.{ms:03}", 62_048_947)
    refuses(
        write(STAMPED + rows.replace("17:14:09", "17:64:09"), "log.csv"), "not all times of day of one kind"
    )
    refuses(
        write(STAMPED + rows.replace("17:14:09", "25:14:09"), "log.csv"), "not all times of day of one kind"
    )


def test_a_row_past_midnight_that_comes_late_stays_on_its_day(write):
    rows = clock_times("{h:02}:{m:02}:{s:02}.{ms:03}", 86_399_800).splitlines(keepends=True)
    rows[19:21] = rows[20], rows[19]
    log = load(write(STAMPED + "".join(rows), "log.csv"))
    np.testing.assert_allclose(log["thrust"].time, np.delete(np.arange(50), 19) * 0.01, atol=1e-9)


def test_times_by_iso_8601_that_contradict_each_other_are_refused(write):
    one_naive = stamped().replace("59.020Z", "59.020")
    refuses(write(STAMPED + one_naive, "log.csv"), "are not all ISO 8601 of one kind")
    refuses(write(STAMPED + stamped().replace("-11-", "-13-"), "log.csv"), "month must be in 1..12")
    word = stamped().replace("2026-11-22T10:59:59.020Z", "later")
    refuses(write(STAMPED + word, "log.csv"), "line 4: 'later' in column .* is not a number")
    refuses(write(STAMPED + stamped(), "log.csv"), "leave time out of units", UnitError, units={"time": "s"})


@pytest.mark.parametrize("dialect", ["spaces", "quoted", "utf-16"])
def test_memory_above_the_imports_is_no_more_than_five_times_the_arrays(tmp_path, dialect):
    """Ten seconds at 10 kHz in 8 columns, read in a process whose peak is that of this load alone."""
    script = Path(__file__).parents[2] / "benchmarks" / "loaders.py"
    out = tmp_path / "found.json"
    options = ["--rows", "100000", "--dialects", dialect, "--json", str(out)]
    subprocess.run([sys.executable, str(script), *options], check=True, capture_output=True)
    (entry,) = json.loads(out.read_text(encoding="utf-8"))["dialects"]
    assert entry["rows"] == 100_000
    # The text is itself 1.4 times the arrays, 2.7 in UTF-16.
    assert 1 < entry["memory"] <= 5


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
