"""Encodings, line ends, delimiters and the two ways of reading numbers, which must agree."""

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
    with pytest.raises(LogError, match=r"line 1: NUL byte"):
        read_text(Source(write("a,b\n1,2\n".encode("utf-16-le"))))


def test_a_quote_never_runs_past_its_line(write):
    path = write('a,b\n1,"2\n3,4\n')
    numbers = numbers_of(path)
    np.testing.assert_array_equal(numbers.columns[1], [2, 4])


def test_comment_and_blank_lines_keep_line_numbers(write):
    numbers = numbers_of(write("\n# made by hand\na,b\n1,2\n\n# note, with, commas\n 3 ,4\n\n# end\n"))
    np.testing.assert_array_equal(numbers.lines, [4, 7])
    np.testing.assert_array_equal(numbers.columns[0], [1, 3])


def test_short_rows_are_missing_and_a_cut_last_line_is_left_out(write):
    numbers = numbers_of(write("a,b,c\n1,2,3\n4,5\n6,7,8\n9,1"))
    np.testing.assert_array_equal(numbers.columns[0], [1, np.nan, 6])
    assert any("line 5, the last, is cut" in note for note in map(str, numbers.notes))
    assert any("line 3" in note for note in map(str, numbers.notes))


def test_last_line_without_end_is_kept_and_noted(write):
    numbers = numbers_of(write("a,b\n1,2\n3,4"))
    np.testing.assert_array_equal(numbers.columns[1], [2, 4])
    assert numbers.open_end
    assert any("may be cut" in note for note in map(str, numbers.notes))


def test_infinite_is_missing(write):
    numbers = numbers_of(write("a,b\n1,inf\n1e999,4\n"))
    np.testing.assert_array_equal(numbers.columns[0], [1, np.nan])
    np.testing.assert_array_equal(numbers.columns[1], [np.nan, 4])
    assert any("infinite number: 2" in note for note in map(str, numbers.notes))


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
    for slow in (False, True):
        if slow:
            monkeypatch.setattr(table, "_read_fast", lambda *_: None)
        with pytest.raises(LogError, match=r"line 3: .* in column 'a' is not a number"):
            numbers_of(path)


@pytest.mark.parametrize("cell", ["+1", "5.", ".5", "1E-5", " 1 ", "nan", "NaN", "", " ", "1e-400", '"1"'])
def test_what_is_a_number_is_the_same_for_both_readers(write, cell, monkeypatch):
    path = write(f"a,b\n1,2\n{cell},3\n")
    fast = numbers_of(path).columns
    monkeypatch.setattr(table, "_read_fast", lambda *_: None)
    slow = numbers_of(path).columns
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
    assert split_label(label) == (stem, unit)


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


def test_times_by_iso_8601_that_contradict_each_other_are_refused(write):
    one_naive = stamped().replace("59.020Z", "59.020")
    refuses(write(STAMPED + one_naive, "log.csv"), "are not all ISO 8601 of one kind")
    refuses(write(STAMPED + stamped().replace("-11-", "-13-"), "log.csv"), "month must be in 1..12")
    word = stamped().replace("2026-11-22T10:59:59.020Z", "later")
    refuses(write(STAMPED + word, "log.csv"), "line 4: 'later' in column .* is not a number")
    refuses(write(STAMPED + stamped(), "log.csv"), "leave time out of units", UnitError, units={"time": "s"})
