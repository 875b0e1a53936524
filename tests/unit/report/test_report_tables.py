"""Tables: what a person reads is what the sets hold."""

import math
import re

import numpy as np
import pytest
from rich.console import Console

from fakes.sets import made_sets
from sysid.documents import rounded
from sysid.report.fold import print_table
from sysid.report.set_tables import mean_sigma_table, mean_table, ranked_table, trial_table
from sysid.report.table import mean_sigma


def lines_of(table, width=110):
    console = Console(width=width)
    with console.capture() as capture:
        print_table(table, console)
    return capture.get().splitlines()


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


def test_report_ranked_table_fits_a_narrow_terminal():
    five = made_sets(
        values=np.repeat(made_sets().values, 2, axis=0)[:5], nrmse=np.full(5, 0.1), runs=(1, 2, 3, 4, 5),
        seeds=(1, 2, 3, 4, 5), at_bound=np.zeros((5, 4)), nrmse_by_trial=np.zeros((5, 2, 2)),
    )  # fmt: skip
    lines = lines_of(ranked_table(five), width=80)
    assert line_with(lines, "k_h [N/m]")[1:] == ["6400", "6400", "6500", "6500", "2000"]


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
