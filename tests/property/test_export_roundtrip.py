"""Every format gives back what it was given, bit for bit, whatever the numbers and texts are."""

import math
from typing import get_args

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sysid import exact_json
from sysid.export import export, load_parameter_sets
from sysid.gear.parameters import PARAMETERS as GEAR_ROWS
from sysid.motor.parameters import PARAMETERS as MOTOR_ROWS
from sysid.parameter_sets import ParameterRecord, ParameterSets, Status

# NaN of one kind only: text formats cannot carry its payload.
FLOATS = st.one_of(
    st.floats(allow_nan=False), st.sampled_from([math.nan, math.inf, -math.inf, -0.0, 5e-324, 0.1])
)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(
    ["NaN", "'Infinity", "-Infinity", "I_sat", "Ω·m²", 'a,"b"\r\n;', "\ufeff", "null", ""]
)
OPTIONAL = st.none() | FLOATS
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | FLOATS | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)
# Names come from code and campaigns, never empty; the rest is free text.
NAMES = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=10)


@st.composite
def parameter_sets(draw):
    n_sets = draw(st.integers(1, 3))
    # A row of a model has the unit of its table; hypothesis draws texts of the code as well.
    new = NAMES.filter(lambda name: name.partition("[")[0] not in {*MOTOR_ROWS, *GEAR_ROWS})
    names = draw(st.lists(new, min_size=1, max_size=4, unique=True))
    trials = draw(st.lists(NAMES, max_size=2, unique=True))
    channels = draw(st.lists(NAMES, max_size=2, unique=True))

    def array(*shape):
        return draw(hnp.arrays(np.float64, shape, elements=FLOATS))

    texts, numbers = ("symbol", "unit", "meaning", "source"), ("nominal", "lower", "upper", "stated_sigma")
    records = [
        ParameterRecord(
            name=name,
            status=draw(st.sampled_from(sorted(get_args(Status)))),
            scale=draw(st.sampled_from(["linear", "log", None])),
            measured_range=draw(st.none() | st.tuples(FLOATS, FLOATS)),
            **{key: draw(TEXTS) for key in texts},
            **{key: draw(OPTIONAL) for key in numbers},
        )
        for name in names
    ]
    moves = np.array([record.status in ("free", "stated") for record in records])
    flags = draw(hnp.arrays(np.int8, (n_sets, len(names)), elements=st.integers(-1, 1)))
    return ParameterSets(
        kind=draw(st.sampled_from(["motor", "gear"])),
        name=draw(TEXTS),
        parameters=tuple(records),
        values=array(n_sets, len(names)),
        nrmse=array(n_sets),
        runs=draw(st.lists(st.integers(0, 99), min_size=n_sets, max_size=n_sets)),
        seeds=draw(st.lists(st.integers(0, 2**64 - 1), min_size=n_sets, max_size=n_sets)),
        at_bound=np.where(moves, flags, 0),
        trials=tuple(trials),
        uses=tuple(draw(st.sampled_from(["fit", "validate"])) for _ in trials),
        channels=tuple(channels),
        channel_units=tuple(draw(TEXTS) for _ in channels),
        channel_weights=tuple(draw(FLOATS) for _ in channels),
        nrmse_by_trial=array(n_sets, len(trials), len(channels)),
        settings=draw(st.dictionaries(TEXTS, JSON, max_size=3)),
        provenance=draw(st.dictionaries(TEXTS, JSON, max_size=3)),
        warnings=tuple(draw(st.lists(TEXTS, max_size=2))),
    )


def assert_bits(a, b):
    nan = np.isnan(a)
    np.testing.assert_array_equal(np.isnan(b), nan)
    np.testing.assert_array_equal(np.where(nan, 0, a).view(np.uint64), np.where(nan, 0, b).view(np.uint64))


@pytest.mark.parametrize("suffix", ["json", "csv", "h5", "mat"])
@given(sets=parameter_sets())
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_round_trip(sets, suffix, tmp_path_factory):
    path = tmp_path_factory.mktemp("sets") / f"sets.{suffix}"
    export(sets, path)
    # Detected by content: the suffix may be lost.
    bare = path.rename(path.with_suffix(".dat"))
    back = load_parameter_sets(bare)
    assert back == sets
    for name in ("values", "nrmse", "nrmse_by_trial"):
        assert_bits(getattr(sets, name), getattr(back, name))
    np.testing.assert_array_equal(sets.at_bound, back.at_bound)
    numbers = [
        number
        for record in sets.parameters
        for number in (record.nominal, record.lower, record.upper, record.stated_sigma,
                       *(record.measured_range or ()))
    ]  # fmt: skip
    assert back.parameters == sets.parameters or any(x is not None and math.isnan(x) for x in numbers)


@given(value=JSON)
@settings(max_examples=300, deadline=None, derandomize=True)
def test_exact_json(value):
    text = exact_json.dumps(value)
    again = exact_json.loads(text)
    assert exact_json.dumps(again) == text
    assert exact_json.dumps(exact_json.plain(value)) == text
