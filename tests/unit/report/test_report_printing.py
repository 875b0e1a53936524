"""No table loses a digit on a narrow terminal."""

import io
from operator import itemgetter

import pytest
from rich.console import Console

from sysid.report.fold import print_table
from sysid.report.table import numbers, table, words

NUMBERS = [["1.234567e-05", "0.0123 ± 0.0004", "98765.4321"], ["-7.1", "12.5 %", "1.0"]]


def made(columns=5):
    remark = "at a bound of the search, as it seems"
    rows = [
        (f"leg stiffness {k}", *(row[i % 3] for i in range(columns)), remark) for k, row in enumerate(NUMBERS)
    ]
    middle = [numbers(f"set {k}", itemgetter(k)) for k in range(1, columns + 1)]
    heads = words("parameter of the model", itemgetter(0)), words("remark", itemgetter(-1))
    return table("a title of some words", rows, (heads[0], *middle, heads[1]), rules=(1,))


def printed(content, width):
    console = Console(file=io.StringIO(), width=width)
    print_table(content, console)
    return console.file.getvalue()


@pytest.mark.parametrize("width", [40, 50, 60, 70, 80, 90, 120])
def test_columns_that_belong_together_stay_beside_each_other(width):
    pairs = [
        numbers(f"{what} {k}", itemgetter(1), joined=what == "noise")
        for k in "ab"
        for what in ("nrmse", "noise")
    ]
    text = printed(table("", [("drop-1", "12.345")], (words("trial", itemgetter(0)), *pairs)), width)
    heads = [line for line in text.splitlines() if "nrmse" in line]
    assert sum(line.count("noise") for line in heads) == 2
    for line in heads:
        assert line.count("nrmse") == line.count("noise")


@pytest.mark.parametrize("width", [8, 20, 33, 47, 60, 79, 80, 120, 200])
def test_every_number_is_whole_at_every_width(width):
    columns = 5
    text = printed(made(columns), width)
    assert "…" not in text
    for k in range(columns):
        for row in NUMBERS:
            assert text.count(row[k % 3]) == sum(row[j % 3] == row[k % 3] for j in range(columns))
        assert text.count(f"set {k + 1}") == 1
    longest = max(len(line.rstrip()) for line in text.splitlines())
    # The widest number, the words of the first column and the rules between them.
    assert longest <= max(width, 40)


def test_a_table_that_fits_is_printed_in_one_piece():
    assert printed(made(2), 200).count("parameter of") == 1
    assert printed(made(2), 45).count("parameter of") > 1
