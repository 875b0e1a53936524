"""Tables: what a person reads is what the sets hold, and no digit is lost on a narrow terminal."""

import io
import math
import re
from operator import itemgetter

import numpy as np
import pytest
from rich.console import Console

from fakes.sets import made_sets
from sysid.documents import rounded
from sysid.report.fold import print_table
from sysid.report.set_tables import mean_sigma_table, mean_table, ranked_table, trial_table
from sysid.report.table import mean_sigma, numbers, table, words


def lines_of(table, width=110):
    console = Console(file=io.StringIO(), width=width)
    print_table(table, console)
    return console.file.getvalue().splitlines()


def line_with(lines, word):
    matching = [line for line in lines if word in line]
    assert len(matching) == 1, (word, lines)
    return re.split(r" {2,}", matching[0].strip())


def test_report_ranked_table_shows_sets_in_order_with_units_and_bounds():
    lines = lines_of(ranked_table(made_sets(channel_weights=(1.0, 3.0))))
    assert line_with(lines, "NRMSE fitted")[1:] == ["8.30 %", "10.00 %", "12.10 %"]
    # The second trial's two channels with weights 1 and 3: (2 + 3·3)/4/7 and so on.
    assert line_with(lines, "NRMSE validated")[1:] == ["39.29 %", "96.43 %", "153.57 %"]
    assert line_with(lines, "run ")[1:] == ["3", "1", "2"]
    assert line_with(lines, "k_h [N/m]")[1:] == ["6400", "6500", "2000*"]
    assert any("within 1 %" in line for line in lines)
    assert not any("m_B" in line for line in lines)


def test_report_mean_sigma_table_has_the_layout_of_table_two():
    lines = lines_of(mean_sigma_table(made_sets()), width=80)
    assert line_with(lines, "m_B [kg]") == ["m_B [kg]", "—", "1.242", "—"]
    # Mean 4967, sigma 2570 (divided by S - 1), two digits of sigma; one set ends at a bound.
    assert line_with(lines, "k_h [N/m]")[1:] == ["5000 ± 2600*", "5600 to 6600", "2000 to 12000"]
    assert any("not the accuracy" in line for line in lines)


def test_a_set_that_was_cut_far_from_the_best_enters_neither_mean_nor_sigma():
    sets = made_sets(nrmse=[0.083, 0.084, 0.34], provenance={"cut_short": "interrupted"})
    lines = lines_of(mean_sigma_table(sets))
    assert line_with(lines, "k_h [N/m]")[1] == "6450 ± 71*"
    assert "1 of the sets left out: cut short above 1.1 × best NRMSE" in " ".join(map(str.strip, lines))


def test_report_trial_table_shows_the_best_and_the_worst_set():
    lines = lines_of(trial_table(made_sets()))
    # In sevenths: 0 and 1 of the best set; 8 and 9 of the worst.
    assert line_with(lines, "drop-1") == ["drop-1", "fit", "0.00", "14.29", "7.14", "121.43"]
    assert line_with(lines, "drop-2")[:2] == ["drop-2", "validate"]


def test_report_tables_of_printed_sets_without_trials_or_scores():
    bare = made_sets(
        values=made_sets().values[:1], nrmse=np.array([np.nan]), runs=(0,), seeds=(0,),
        at_bound=np.zeros((1, 4)), trials=(), uses=(), channels=(), channel_units=(), channel_weights=(),
        nrmse_by_trial=np.empty((1, 0, 0)),
    )  # fmt: skip
    lines = lines_of(ranked_table(bare))
    assert line_with(lines, "NRMSE fitted")[1:] == ["—"]
    assert not any("validated" in line or "run " in line for line in lines)
    assert lines_of(trial_table(bare))
    assert line_with(lines_of(mean_sigma_table(bare), 130), "k_h [N/m]")[1] == "6400"


@pytest.mark.parametrize("make", [ranked_table, mean_sigma_table, trial_table])
def test_report_tables_print_brackets_as_text(make):
    sets = made_sets(name="[bold]lab[/bold]")
    assert any("[bold]lab[/bold]" in line for line in lines_of(make(sets), 130))


def test_mean_table_is_table_two():
    rows = mean_table(made_sets(), made_sets(values=[[6670.0, 1.242, np.inf, 0.1]] * 3))
    assert [row.record.name for row in rows] == ["leg_axial_stiffness", "body_mass"]
    stiffness, mass = rows
    column = np.array([6400.1, 6500.3, 2000.1])
    # σ over the runs is the sample's: divided by S - 1.
    spread = [number for known in stiffness.fitted for number in (known.mean, known.sigma)]
    assert spread == pytest.approx([column.mean(), column.std(ddof=1), 6670.0, 0.0])
    assert stiffness.measured == (5600.0, 6600.0)
    assert mass.measured == (1.242,)
    assert mass.fitted == (None, None)


@pytest.mark.parametrize(
    ("mean", "sigma", "text"),
    [
        (0.052, 0.0401, "0.052 ± 0.040"),  # two digits of σ
        (5.2e-9, 4.01e-9, "(5.2 ± 4.0)e-9"),
        (0.298783, 2e-7, "0.2988 (σ < 1e-6)"),  # runs that agree do not make digits
        (9.0123e-9, 2e-16, "9.012e-9 (σ < 1e-15)"),
        (0.298783, 2e-5, "0.2988 ± 2e-05"),
        (0.298783, 0.0012, "0.2988 ± 0.0012"),
        (12345.0, 2.0, "12345 ± 2"),
        (0.0, 2e-3, "0.0000 ± 0.0020"),
        (97442.0, 33113.0, "97000 ± 33000"),  # no more digits than the spread allows
        (113_340.0, 250.0, "113340 ± 250"),
        (1.05, 2.2e-16, "1.050 (σ < 1e-6)"),
        (math.nan, 1.0, "—"),
    ],
)
def test_digits_of_mean_and_sigma(mean, sigma, text):
    assert mean_sigma((mean, sigma)) == text


def test_large_numbers_without_exponent():
    assert [rounded(v) for v in (113_340.0, 1.2e4, 2e4, 0.04, 9e-9, 3e8)] == [
        "113300", "12000", "20000", "0.04", "9e-09", "3e+08",
    ]  # fmt: skip


NUMBERS = [["1.234567e-05", "0.0123 ± 0.0004", "98765.4321"], ["-7.1", "12.5 %", "1.0"]]


def made(columns=5):
    remark = "at a bound of the search, as it seems"
    rows = [
        (f"leg stiffness {k}", *(row[i % 3] for i in range(columns)), remark) for k, row in enumerate(NUMBERS)
    ]
    middle = [numbers(f"set {k}", itemgetter(k)) for k in range(1, columns + 1)]
    heads = words("parameter of the model", itemgetter(0)), words("remark", itemgetter(-1))
    return table("a title of some words", rows, (heads[0], *middle, heads[1]), rules=(1,))


@pytest.mark.parametrize("width", [40, 50, 60, 70, 80, 90, 120])
def test_columns_that_belong_together_stay_beside_each_other(width):
    pairs = [
        numbers(f"{what} {k}", itemgetter(1), joined=what == "noise")
        for k in "ab"
        for what in ("nrmse", "noise")
    ]
    lines = lines_of(table("", [("drop-1", "12.345")], (words("trial", itemgetter(0)), *pairs)), width)
    heads = [line for line in lines if "nrmse" in line]
    assert sum(line.count("noise") for line in heads) == 2
    for line in heads:
        assert line.count("nrmse") == line.count("noise")


@pytest.mark.parametrize("width", [8, 20, 33, 47, 60, 79, 80, 120, 200])
def test_every_number_is_whole_at_every_width(width):
    columns = 5
    text = "\n".join(lines_of(made(columns), width))
    assert "…" not in text
    for k in range(columns):
        for row in NUMBERS:
            assert text.count(row[k % 3]) == sum(row[j % 3] == row[k % 3] for j in range(columns))
        assert text.count(f"set {k + 1}") == 1
    longest = max(len(line.rstrip()) for line in text.splitlines())
    # The widest number, the words of the first column and the rules between them.
    assert longest <= max(width, 40)


def test_a_table_that_fits_is_printed_in_one_piece():
    assert "".join(lines_of(made(2), 200)).count("parameter of") == 1
    assert "".join(lines_of(made(2), 45)).count("parameter of") > 1
