"""No table loses a digit on a narrow terminal."""

import io

import pytest
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sysid.report.fold import folded, print_table

NUMBERS = [["1.234567e-05", "0.0123 ± 0.0004", "98765.4321"], ["-7.1", "12.5 %", "1.0"]]


def table(columns=5, shape=None, title=True):
    made = Table(box=shape, title=Text("a title of some words") if title else None, pad_edge=False)
    made.add_column("parameter of the model", no_wrap=False)
    for k in range(columns):
        made.add_column(f"set {k + 1}", justify="right")
    made.add_column("remark")
    for k, row in enumerate(NUMBERS):
        cells = [row[i % 3] for i in range(columns)]
        made.add_row(f"leg stiffness {k}", *cells, Text("at a bound of the search, as it seems"))
        made.add_section()
    return made


def printed(made, width):
    console = Console(file=io.StringIO(), width=width)
    print_table(made, console)
    return console.file.getvalue()


@pytest.mark.parametrize("shape", [None, box.SIMPLE_HEAD, box.HEAVY_HEAD])
@pytest.mark.parametrize("width", [8, 20, 33, 47, 60, 79, 80, 120, 200])
def test_every_number_is_whole_at_every_width(shape, width):
    columns = 5
    said = printed(table(columns, shape), width)
    assert "…" not in said
    for k in range(columns):
        for row in NUMBERS:
            assert said.count(row[k % 3]) == sum(row[j % 3] == row[k % 3] for j in range(columns))
        assert said.count(f"set {k + 1}") == 1
    longest = max(len(line.rstrip()) for line in said.splitlines())
    # The widest number, the words of the first column and the rules between them.
    assert longest <= max(width, 40)


def test_a_table_that_fits_is_left_as_it_is():
    made = table(2)
    assert folded(made, 200) == [made]
    assert len(folded(made, 45)) > 1
    assert printed(made, 200).count("leg stiffness 0") == 1


def test_rich_alone_cuts_these_numbers():
    # What this module is for: without it the same table loses digits.
    console = Console(file=io.StringIO(), width=47)
    console.print(table())
    assert "98765.4321" not in console.file.getvalue()
