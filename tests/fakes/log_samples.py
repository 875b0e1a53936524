"""Small logs of every text format, as the instruments write them, and how each one is damaged.

A log is bytes; a damage takes a `Log` and a random generator and returns bytes.
"""

import re
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np


def stand():
    random = np.random.default_rng(1)
    names = "Time (s),ESC signal (µs),Servo 1 (µs),Torque (N·m),Thrust (gf),Motor Optical Speed (rad/s),"
    rows = []
    for i, (x, y, z) in enumerate(random.normal(size=(40, 3)) * 100 + 500):
        thrust, message = ("", "") if i % 3 else (f"{y:.9f}", '"late, sample"')
        rows.append(f"{i * 0.012:.6f},{1000 + 10 * i},,{x:.9f},{thrust},{abs(z):.6f},{message},")
    lines = ["\ufeff" + names + "App message,", *rows, "# fitted by hand", "# tau: 0.027", ""]
    return "\r\n".join(lines).encode("utf-8")


def cell():
    rows = ["Time (s),Command (us),Speed (rad/s),Fz (N),Mz (N·m)"]
    for i, (a, b, c) in enumerate(np.random.default_rng(2).normal(size=(40, 3))):
        rows.append(f"{i * 1e-4:.4f},{1500 + i},{a:.4f},{f'{b:.6f}' if i % 6 else ''},{c:.8f}")
    return "\n".join([*rows, ""]).encode("utf-8")


def motive():
    random = np.random.default_rng(3)
    parts = ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error"
    out = [
        "Format Version,1.23,Take Name,drop,Capture Frame Rate,200.000000,Export Frame Rate,200.000000,"
        "Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
        "",
        ",Type" + ",Rigid Body" * 8 + ",Marker" * 3,
        ",Name" + ",quad" * 8 + ",board" * 3,
        ",ID" + ',"AB"' * 8 + ",CD" * 3,
        parts + ",Position" * 3,
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z",
    ]
    for i in range(40):
        place = ",".join(f"{x:.6f}" for x in random.normal(size=3) * 1000)
        pose = f"0.600000,0.000000,0.000000,{-0.8 if i % 7 else 0.8:.6f},{place},0.000210"
        out.append(f"{i},{i / 200:.6f},{pose if i % 5 else ',' * 7},{place}")
    return "\r\n".join([*out, ""]).encode("utf-8")


def pose():
    rows = ["t,x_m,y_m,z_m,qx,qy,qz,qw"]
    for i, (x, y, z) in enumerate(np.random.default_rng(4).normal(size=(40, 3))):
        rows.append(f"{1.7e9 + i * 0.01:.4f},{x:.6f},{f'{y:.6f}' if i % 9 else ''},{z:.6f},0.6,0,0,0.8")
    return "\n".join([*rows, ""]).encode("utf-8")


def lvm():
    lines = [
        "LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
        "X_Columns\tOne", "Date\t2024/01/02", "Time\t09:00:00.0", "***End_of_Header***", "",
        "Channels\t3\t\t\t", "Samples\t40\t40\t40\t", "Y_Unit_Label\tus\tNewtons\tN*m\t",
        "X0\t0.0\t0.0\t0.0\t", "Delta_X\t0.001\t0.001\t0.001\t", "***End_of_Header***\t\t\t\t",
        "X_Value\tCommand\tFz\tMz\tComment",
    ]  # fmt: skip
    for i, (a, b) in enumerate(np.random.default_rng(5).normal(size=(40, 2))):
        force = f"{a:.6f}" if i % 8 else ""
        lines.append(f"{i * 0.001:.6f}\t{1000 + i}\t{force}\t{b:.8f}" + ("\tLOST" if i % 9 == 4 else ""))
    return "\n".join([*lines, ""]).encode("utf-8")


def vicon():
    random = np.random.default_rng(6)
    lines = ["Objects,", "100,", ",,Global Angle (Quaternion) quad:quad,,,,,,,"]
    lines += ["Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ,", ",,,,,,mm,mm,mm,"]
    for i in range(40):
        place = ",".join(f"{x:.4f}" for x in random.normal(size=3) * 1000)
        lines.append(f"{i + 1},0," + (f"0.6,0,0,0.8,{place}," if i % 5 else ""))
    lines += ["", "Trajectories,", "100,", ",,board:1,,,board:2,,,"]
    lines += ["Frame,Sub Frame,X,Y,Z,X,Y,Z,", ",,mm,mm,mm,mm,mm,mm,"]
    for i in range(40):
        place = ",".join(f"{x:.4f}" for x in random.normal(size=6) * 1000)
        lines.append(f"{i + 1},0,{place if i % 7 else ',,,,,'},")
    return "\r\n".join([*lines, ""]).encode("utf-8")


def qualisys():
    from scipy.spatial.transform import Rotation

    lines = [
        "NO_OF_FRAMES\t40", "NO_OF_CAMERAS\t8", "NO_OF_BODIES\t1", "FREQUENCY\t200",
        "TIME_STAMP\t2026-01-19, 10:19:43.755\t2063631.96", "DATA_INCLUDED\t6D", "BODY_NAMES\tquad",
        "Frame\tTime\tquad X\tY\tZ\tRoll\tPitch\tYaw\tResidual\t"
        + "\t".join(f"Rot[{i}]" for i in range(9)) + "\t",
    ]  # fmt: skip
    turns = Rotation.from_rotvec(np.random.default_rng(7).normal(size=(40, 3))).as_matrix()
    for i, matrix in enumerate(turns):
        cells = [i * 10.5, 2.0, 3.0, 0, 0, 0, 0.3, *matrix.T.ravel()] if i % 6 else [0.0] * 16
        blank = {3: range(3), 5: range(16)}.get(i % 7, ())
        shown = ["" if k in blank else f"{x:.6f}" for k, x in enumerate(cells)]
        lines.append(f"{i + 1}\t{i / 200:.5f}\t" + "\t".join(shown) + "\t")
    return "\r\n".join([*lines, ""]).encode("utf-8")


def ros():
    names = "%time,field.header.seq,field.header.stamp,field.header.frame_id"
    names += "".join(f",field.pose.position.{axis}" for axis in "xyz")
    names += "".join(f",field.pose.orientation.{axis}" for axis in "xyzw")
    lines = [names]
    for i, (x, y, z) in enumerate(np.random.default_rng(9).normal(size=(40, 3))):
        stamp = 1538000000123456789 + i * 10_000_000
        place = f"{x:.6f},{y:.6f},{z:.6f}" if i % 10 else ",,"
        lines.append(f"{stamp + 300_000},{i},{stamp},world,{place},0.0,0.6,0.0,0.8")
    return "\n".join([*lines, ""]).encode("utf-8")


def net_ft():
    lines = [
        "Start Time: 1/2/24 3:04 PM", "RDT Sample Rate: 1000", "Force Units: N",
        "Counts per Unit Force: 1000000.0", "Torque Units: Nm", "Counts per Unit Torque: 1000000.0",
        "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time",
    ]  # fmt: skip
    for i, row in enumerate(np.random.default_rng(10).integers(-(10**7), 10**7, size=(40, 6))):
        counts = ", ".join(str(int(number)) if i % 9 or k else "" for k, number in enumerate(row))
        lines.append(f"0, {500 + i + (i > 20)}, {9000 + 7 * i}, {counts}, 3:04:05.{i:03d} PM")
    return "\n".join([*lines, ""]).encode("utf-8")


def ati():
    lines = ["First line indicates sampling freq [Hz], samples per channel, QTimer [ms] ,,,"]
    lines += ["Fx, Fy, Fz, Mz, My, Mz ", "150,75,500,0,0,"]
    for i, row in enumerate(np.random.default_rng(11).normal(size=(40, 6))):
        lines.append(",".join(f"{x:.6f}" for x in row) if i % 8 != 3 else ",,,,,")
    return "\n".join([*lines, ""]).encode("utf-8")


@dataclass(frozen=True)
class Log:
    """One text log: its bytes, delimiter, the lines that name its columns and hold its first row, from 0.

    `units` are pairs of a printed unit and another: what is written in the header says what the numbers are.
    """

    data: bytes
    delimiter: str
    names: int | None
    first: int
    units: tuple[tuple[str, str], ...] = ()
    options: Mapping[str, object] = field(default_factory=dict)


_FORCES = (("gf", "N"), ("gf", "kgf"), ("gf", "lbf"), ("gf", "mN"), ("gf", "g"), ("gf", "V"), ("gf", ""))
_TORQUES = (("N·m", "mN·m"), ("N·m", "N·mm"), ("N·m", "lbf-in"), ("N·m", "N"), ("N·m", "J/K"))
_SPEEDS = (("rad/s", "RPM"), ("rad/s", "deg/s"), ("rad/s", "Hz"), ("rad/s", "m/s"))
_LENGTHS = (("mm", "m"), ("mm", "cm"), ("mm", "inch"), ("mm", "V"), ("mm", ""), ("mm", "mm²"))
_WORDS = tuple(("Millimeters", unit) for unit in ("Meters", "Centimeters", "Inches", "Parsnips", ""))

LOGS = {
    "rcbenchmark-csv": Log(stand(), ",", 0, 1, (*_FORCES, *_TORQUES, *_SPEEDS, ("(s)", "(ms)"), ("µs", "%"))),
    "load-cell-csv": Log(
        cell(), ",", 0, 1, (("(N)", "(lbf)"), ("(N)", "(kN)"), ("(N)", "(Pa)"), *_TORQUES, *_SPEEDS,
                            ("(s)", "(ms)"), ("(s)", "(m)"))
    ),
    "motive-csv": Log(motive(), ",", 6, 7, (*_WORDS, ("200.000000", "100.000000"), ("Quaternion", "XYZ"))),
    "pose-table": Log(pose(), ",", 0, 1, (("x_m", "x_mm"), ("_m", "_mm"), ("_m", "_V"), ("t,", "t [min],"))),
    "lvm": Log(
        lvm(), "\t", 15, 16, (("Newtons", "lbf"), ("Newtons", "kN"), ("Newtons", "Volts"), ("N*m", "N*mm"),
                              ("us", "V"), ("X_Columns\tOne", "X_Columns\tNo"))
    ),
    "vicon-csv": Log(vicon(), ",", 3, 5, (*_LENGTHS, ("\n100,", "\n200,"))),
    "qualisys-tsv": Log(qualisys(), "\t", 7, 8, (("FREQUENCY\t200", "FREQUENCY\t250"), ("6D", "3D"))),
    "ros-csv": Log(ros(), ",", 0, 1, (("position", "covariance"), ("orientation", "position"))),
    "net-ft-csv": Log(
        net_ft(), ",", 6, 7, (("Force Units: N", "Force Units: lbf"), ("Units: Nm", "Units: lbf-in"),
                              ("Force Units: N", "Force Units: Nm"), ("1000000.0", "500000.0"))
    ),
    "ati-text": Log(
        ati(), ",", 1, 3, (("150,", "300,"), ("150,", "-150,")), {"units": {"force": "N", "torque": "N*m"}}
    ),
}  # fmt: skip


def _number(random, low, high):
    return int(random.integers(low, high))


def _text(log):
    return log.data.decode("utf-8")


def cut(log, random):
    return log.data[: _number(random, 0, len(log.data))]


def flip(log, random):
    changed = bytearray(log.data)
    for _ in range(_number(random, 1, 5)):
        changed[_number(random, 0, len(changed))] ^= 1 << _number(random, 0, 8)
    return bytes(changed)


def splash(log, random):
    at = _number(random, 0, len(log.data))
    return log.data[:at] + random.bytes(_number(random, 1, 30)) + log.data[at + _number(random, 0, 30) :]


def drop_column(log, random):
    """One or two columns gone from all lines, from the rows alone, or from the line of names alone."""
    lines = _text(log).split("\n")
    width = max(line.count(log.delimiter) for line in lines) + 1
    gone = {_number(random, 0, width) for _ in range(_number(random, 1, 3))}
    where = _number(random, 0, 3)

    def without(i, line):
        if (where == 1 and i < log.first) or (where == 2 and i != log.names):
            return line
        return log.delimiter.join(c for k, c in enumerate(line.split(log.delimiter)) if k not in gone)

    return "\n".join(without(i, line) for i, line in enumerate(lines)).encode("utf-8")


def shuffle_rows(log, random):
    lines = log.data.split(b"\n")
    first = _number(random, 0, len(lines)) if random.random() < 0.5 else log.first
    # Two rows exchanged, or all of them in disorder.
    order = np.arange(len(lines) - first)
    if random.random() < 0.5:
        random.shuffle(order)
    elif order.size > 2:
        a, b = random.choice(order.size - 1, 2, replace=False)
        order[[a, b]] = order[[b, a]]
    return b"\n".join(lines[:first] + [lines[first + i] for i in order])


def drop_or_double_lines(log, random):
    lines = log.data.split(b"\n")
    if random.random() < 0.5:
        return b"\n".join(line for line in lines for _ in range(_number(random, 0, 3)))
    at = _number(random, 0, len(lines))
    return b"\n".join([*lines[:at], *lines[at : at + 1] * _number(random, 0, 3), *lines[at + 1 :]])


def second_header(log, random):
    lines = log.data.split(b"\n")
    at = _number(random, 1, len(lines))
    return b"\n".join([*lines[:at], *lines[: _number(random, 1, log.first + 2)], *lines[at:]])


def no_rows(log, random):
    return b"\n".join(log.data.split(b"\n")[: _number(random, 1, log.first + 1)]) + b"\n"


def gigantic_field(log, random):
    at = _number(random, 0, len(log.data))
    filling = [b"9", b"a", b'"', b",", b"\n", b"1,", b"1\t", b"-", b" "][_number(random, 0, 9)]
    return log.data[:at] + filling * 200_000 + log.data[at:]


def nul(log, random):
    at = _number(random, 0, len(log.data))
    return log.data[:at] + b"\0" + log.data[at:]


def utf16(log, random):
    coding = ["utf-16", "utf-16-le", "utf-16-be"][_number(random, 0, 3)]
    data = _text(log).encode(coding)
    return data if random.random() < 0.5 else data[: len(data) - _number(random, 0, 200)]


def other_delimiter(log, random):
    new = [";", "\t", " ", "|", log.delimiter * 2][_number(random, 0, 5)]
    text = _text(log).replace(log.delimiter, new)
    if new in ";\t" and random.random() < 0.5:
        head, rows = text.split("\n")[: log.first], text.split("\n")[log.first :]
        text = "\n".join(head + [row.replace(".", ",") for row in rows])
    return text.encode("utf-8")


def doubled_delimiter(log, random):
    """A delimiter too many in some place."""
    data, mark = log.data, log.delimiter.encode()
    places = [i for i in range(len(data)) if data[i : i + 1] == mark]
    at = places[_number(random, 0, len(places))]
    return data[:at] + mark + data[at:]


@contextmanager
def _cells(log, lines, at):
    """Let the caller change the list of cells of a line."""
    end = "\r" if lines[at].endswith("\r") else ""
    cells = lines[at].removesuffix("\r").split(log.delimiter)
    yield cells
    lines[at] = log.delimiter.join(cells) + end


def ragged_rows(log, random):
    """Some rows lose cells at their end, or have some more."""
    lines = _text(log).split("\n")
    for _ in range(_number(random, 1, 6)):
        with _cells(log, lines, _number(random, log.first, len(lines))) as cells:
            if random.random() < 0.6:
                del cells[_number(random, 0, len(cells)) :]
            else:
                cells += [["", "7", "x", " "][_number(random, 0, 4)]] * _number(random, 1, 4)
    return "\n".join(lines).encode("utf-8")


def lost_cell(log, random):
    """One row loses a cell with its delimiter, anywhere in it."""
    lines = _text(log).split("\n")
    with _cells(log, lines, _number(random, log.first, len(lines) - 1)) as cells:
        del cells[_number(random, 0, len(cells))]
    return "\n".join(lines).encode("utf-8")


def exchanged_header_rows(log, random):
    """Two lines of the header, or one of them and the first row, change places."""
    lines = log.data.split(b"\n")
    a, b = random.choice(log.first + 1, 2, replace=False) if log.first else (0, 1)
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def swapped_names(log, random):
    """Two names of columns change places: then each number is what its own column's name now says."""
    lines = _text(log).split("\n")
    with _cells(log, lines, log.names if log.names is not None else log.first) as cells:
        a, b = _number(random, 0, len(cells)), _number(random, 0, len(cells))
        cells[a], cells[b] = cells[b], cells[a]
    return "\n".join(lines).encode("utf-8")


def other_unit(log, random):
    """Another unit, or other numbers that say what the rows mean, in the header."""
    lines = _text(log).split("\n")
    first = min(log.first, len(lines))
    old, new = log.units[_number(random, 0, len(log.units))]
    head = "\n".join(lines[:first])
    places = head.count(old)
    # The first, or all of them.
    head = head.replace(old, new, 1 if random.random() < 0.5 else places)
    return "\n".join([head, *lines[first:]]).encode("utf-8")


def other_number(log, random):
    """One cell of a row becomes blank, a word, an infinite or a huge number."""
    lines = _text(log).split("\n")
    new = ["", " ", "nan", "inf", "-Infinity", "1e400", "1e308", "0x10", "1_000", "--5", "N/A", "1.5.2", "٣"]
    with _cells(log, lines, _number(random, log.first, len(lines) - 1)) as cells:
        value = new[_number(random, 0, len(new))]
        cells[_number(random, 0, len(cells))] = value
    return "\n".join(lines).encode("utf-8")


def _digits(log, random):
    """Return begin and end of a number anywhere in a log."""
    places = [match.span() for match in re.finditer(rb"[0-9]+", log.data)]
    return places[_number(random, 0, len(places))]


def other_digit(log, random):
    """One digit becomes another."""
    begin, end = _digits(log, random)
    at = _number(random, begin, end)
    return log.data[:at] + b"%d" % _number(random, 0, 10) + log.data[at + 1 :]


def many_digits(log, random):
    """One number gets 5,000 digits, more than Python turns into an integer."""
    begin, end = _digits(log, random)
    return log.data[:begin] + b"9" * 5000 + log.data[end:]


def nesting(log, random):
    """One number becomes brackets or quotes inside each other, closed or not."""
    begin, end = _digits(log, random)
    left, right = [(b"[", b"]"), (b"(", b")"), (b"{", b"}"), (b'"', b'"'), (b"<", b">")][
        _number(random, 0, 5)
    ]
    return log.data[:begin] + left * 2000 + right * _number(random, 0, 2) * 2000 + log.data[end:]


DAMAGES = (
    cut, flip, splash, drop_column, shuffle_rows, drop_or_double_lines, second_header, no_rows, nul, utf16,
    other_delimiter, doubled_delimiter, ragged_rows, swapped_names, other_unit, other_number,
    lost_cell, exchanged_header_rows, other_digit, many_digits, nesting,
)  # fmt: skip


# --- documents: TOML and JSON -------------------------------------------------------------------------------

# Values that a key of a document gets; each is a value of TOML, of JSON, or of neither.
_VALUES = (
    "true", "[]", "{}", '""', '"nan"', "nan", "NaN", "null", "-1", "0", "1e308", "1e999", "-0.0",
    "1" + 400 * "0", '"5 parsecs"', '"-3 g ± 300 %"', '"TODO"', "[1, 2, 3]", '[["a"]]', '"../etc/passwd"',
    '"CON"', "1979-05-27", '"\\u0000"', '"' + 5000 * "x" + '"', "1_000", "0x10",
)  # fmt: skip


def other_value(log, random):
    """A key gets another value."""
    lines = _text(log).split("\n")
    named = [i for i, line in enumerate(lines) if log.delimiter in line]
    at = named[_number(random, 0, len(named))]
    key, value = lines[at].split(log.delimiter, 1)
    lines[at] = key + log.delimiter + _VALUES[_number(random, 0, len(_VALUES))] + "," * value.endswith(",")
    return "\n".join(lines).encode("utf-8")


def other_key(log, random):
    """A key of one line is lost, doubled, misspelt, or another line's."""
    lines = _text(log).split("\n")
    named = [i for i, line in enumerate(lines) if log.delimiter in line]
    a, b = (named[_number(random, 0, len(named))] for _ in range(2))
    key, value = lines[a].split(log.delimiter, 1)
    other = lines[b].split(log.delimiter, 1)[0]
    new = ["", key[:-1] + "x", other, key.upper(), 100 * key][_number(random, 0, 5)]
    lines[a] = new + log.delimiter + value
    return "\n".join(lines + lines[a : a + 1] * _number(random, 0, 2)).encode("utf-8")


DOCUMENT_DAMAGES = (
    cut, flip, splash, shuffle_rows, drop_or_double_lines, nul, utf16, other_number, lost_cell,
    exchanged_header_rows, other_digit, many_digits, nesting, other_value, other_key, other_value,
)  # fmt: skip
