"""What the code computes is what it computed when the golden record was written; see `record`."""

import json

import pytest
import record
import subjects


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=pytest.mark.slow if one in subjects.SLOW else ()) for one in subjects.SUBJECTS],
)
def test_as_recorded(name):
    needed = subjects.NEEDS.get(name)
    if needed is not None and not needed.is_dir():
        pytest.skip(f"NOT COMPARED: {needed} is not there")
    values, machine = record.read(name)
    exact = machine == subjects.machine()
    wrong = record.same(values, subjects.SUBJECTS[name](), exact)
    how = "to the bit, on the machine of the record" if exact else "within tolerances, on another machine"
    assert not wrong, f"{name}, compared {how}: {len(wrong)} values differ\n" + "\n".join(wrong[:20])


@pytest.mark.parametrize("name", subjects.SUBJECTS)
def test_this_machine_is_that_of_the_record(name):
    then, now = record.read(name)[1], subjects.machine()
    if differs := [key for key in then if then[key] != now.get(key)]:
        pytest.skip(f"COMPARED WITHIN TOLERANCES ONLY: {', '.join(differs)} differ from the record's")


def test_every_record_has_its_subject():
    assert {path.stem for path in record.VALUES.iterdir()} == {*subjects.SUBJECTS}


THEN = {"always": {"name": "lf", "n": 3}, "benches": [(0.5).hex(), "nan"], "best": 0.3, "here": ["a"]}


@pytest.mark.parametrize(
    ("level", "value", "wrong_here", "wrong_elsewhere"),
    [
        ("always", {"name": "lf", "n": 3}, 0, 0),
        ("always", {"name": "lf", "n": 4}, 1, 1),
        ("always", {"name": "lf"}, 1, 1),
        ("always", {"name": "lf", "n": 3, "more": 0}, 1, 1),
        ("benches", [(0.5 + 1e-9).hex(), "nan"], 1, 0),
        ("benches", [(0.5 + 1e-5).hex(), "nan"], 1, 1),
        ("benches", [(0.5).hex(), (0.5).hex()], 1, 1),
        ("benches", [(0.5).hex()], 1, 1),
        ("best", 0.31, 1, 0),
        ("best", 0.4, 1, 1),
        ("here", ["b"], 1, 0),
    ],
)
def test_the_comparison_can_fail(level, value, wrong_here, wrong_elsewhere):
    now = {**json.loads(json.dumps(THEN)), level: value}
    assert len(record.same(THEN, now, True)) == wrong_here
    assert len(record.same(THEN, now, False)) == wrong_elsewhere


def test_one_cell_in_twenty_may_change_its_class_elsewhere():
    none, one, two = ([1] * n + [0] * (20 - n) for n in range(3))
    assert record.same({"cells": none}, {"cells": one}, False) == []
    assert len(record.same({"cells": none}, {"cells": two}, False)) == 2
    assert len(record.same({"cells": none}, {"cells": one}, True)) == 1
