"""Time and memory of reading a minute of a 10 kHz load cell (8 columns, 50 MB): dialects of CSV, and HDF5.

Run ``python tests/benchmarks/loaders.py [--rows N] [--dialects NAMES] [--json PATH]``. Every reading is a
separate process: seconds of processor time and of the clock, MB/s of processor time, and the peak of memory
above the imports as a multiple of the arrays (8 bytes a number).

``--long`` reads ten minutes (6 million rows) as CSV and as HDF5, plain and compressed, and ends with 1 where
one takes more than 12 s of processor time or 6 times the memory of its arrays: 7.9 s and 3.1, 4.0 s and 3.3,
5.6 s and 3.5 on two cores that twenty processes shared.
"""

import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from paired import flags, measured, memory, report

COLUMNS = ["Time (s)", "Command (us)", "Speed (rad/s)", "Fx (N)", "Fy (N)", "Fz (N)", "Mx (N·m)", "Mz (N·m)"]
# delimiter, decimal mark, line end, encoding, and every how many rows something odd stands in one.
DIALECTS = {
    "comma": (",", ".", "\n", "utf-8", 0),
    "crlf": (",", ".", "\r\n", "utf-8-sig", 0),
    "semicolon": (";", ",", "\n", "utf-8", 0),
    "tab": ("\t", ".", "\n", "utf-8", 0),
    "spaces": (" ", ".", "\n", "utf-8", 0),
    "quoted": (",", ".", "\n", "utf-8", 100),
    "comments": (",", ".", "\n", "utf-8", 1000),
    "blanks": (",", ".", "\n", "utf-8", 50),
    "windows-1252": (",", ".", "\n", "cp1252", 0),
    "utf-16": (",", ".", "\n", "utf-16", 0),
    "hdf5": None,
    "hdf5-gzip": None,
}
LONG = (6_000_000, ("comma", "hdf5", "hdf5-gzip"), 12.0, 6.0)


def write_log(path, dialect, rows):
    """Write a log: numbers of nine digits that repeat every 2000 rows, on a clock that does not."""
    import numpy as np

    if DIALECTS[dialect] is None:
        write_hdf5(path, rows, {"compression": "gzip", "shuffle": True} if dialect.endswith("gzip") else {})
        return
    mark, decimal, end, encoding, odd = DIALECTS[dialect]
    random = np.random.default_rng(0)
    block = [
        mark.join(f"{x:.9g}" for x in row).replace(".", decimal)
        for row in random.normal(size=(2000, len(COLUMNS) - 1)) * 1000
    ]
    gap = " " * 3 if mark == " " else mark
    with path.open("w", encoding=encoding, newline="") as stream:
        stream.write(mark.join(COLUMNS) + end)
        for begin in range(0, rows, 10_000):
            lines = []
            for i in range(begin, min(begin + 10_000, rows)):
                line = f"{i * 1e-4:.4f}".replace(".", decimal) + gap + block[i % 2000]
                if odd and i % odd == odd - 1:
                    first, *others = line.split(mark)
                    if dialect == "quoted":
                        line = mark.join([f'"{first}"', *others])
                    elif dialect == "comments":
                        line = f"# a note, by hand{end}{line}"
                    else:
                        line = mark.join([first, "", *others[1:]])
                lines.append(line)
            stream.write(end.join(lines) + end)


def write_hdf5(path, rows, packed):
    """Write the columns as datasets, on the clock of the file's rate."""
    import h5py
    import numpy as np

    random = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file.attrs["rate"] = 1e4
        for column in COLUMNS[1:]:
            name, unit = column.rstrip(")").split(" (")
            values = (random.normal(size=rows) * 1000).round(3)
            file.create_dataset(name, data=values, **packed).attrs["unit"] = unit


def measure(path):
    """Read once in this process; print seconds and bytes as JSON."""
    import pandas as pd

    from sysid.loaders import formats, load
    from sysid.units import factor_to_si

    # Imports that the first load of any log makes.
    formats()
    factor_to_si("N", "N")
    pd.read_csv(io.StringIO("1,2\n"), header=None)
    before = memory(peak=False)
    wall, spent, values = measured(lambda: load(path)["thrust"].values)
    numbers = len(values) * len(COLUMNS)
    print(json.dumps({"rows": len(values), "seconds": spent, "wall": wall,
                      "memory": (memory(peak=True) - before) / (8 * numbers)}))  # fmt: skip


def benchmark(rows, dialects):
    """Return what the reading of each dialect takes."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "minute.csv"
        for dialect in dialects:
            write_log(path, dialect, rows)
            size = path.stat().st_size / 1e6
            command = [sys.executable, __file__, "--measure", str(path)]
            done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
            entry = json.loads(done.stdout)
            if entry["rows"] != rows:
                raise RuntimeError(f"{dialect}: {entry['rows']} rows were read, {rows} written")
            speed = size / entry["seconds"]
            results.append({"dialect": dialect, "megabytes": size, "megabytes_per_second": speed, **entry})
    return results


def main():
    """Run the benchmark as the first lines of this file say."""
    parser = flags(__doc__.splitlines()[0], rows=600_000, dialects=",".join(DIALECTS))
    parser.add_argument("--long", action="store_true", help="ten minutes as CSV and HDF5, within limits")
    parser.add_argument("--measure", type=Path, metavar="PATH")
    options = parser.parse_args()
    if options.measure:
        measure(options.measure)
        return
    rows, dialects = LONG[:2] if options.long else (options.rows, options.dialects.split(","))
    results = benchmark(rows, dialects)
    report({"dialects": results}, options.json)
    if options.long:
        sys.exit(any(entry["seconds"] > LONG[2] or entry["memory"] > LONG[3] for entry in results))


if __name__ == "__main__":
    main()
