"""Predictions against noise, fits against each other, and what lies in a fit folder."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest

from sysid import exact_json
from sysid.errors import FitError, SysidWarning
from sysid.fit.adequacy import UNSEARCHED
from sysid.fit.trial import Trial
from sysid.parameter_sets import INTERVALS, NOT_ALONE, ParameterRecord, ParameterSets
from sysid.trust.comparison import compare_values, unjudged
from sysid.trust.documents import (
    FreeParameter,
    StatedValue,
    TrustDocument,
    ValidationDocument,
    free_part,
    parts,
    read_arrays,
    validation_part,
    write_part,
)
from sysid.trust.validation import LEAVES, judge, reasons

CHANNELS = ("x_B", "z_B")


def _judge(time, measured, simulated, *, spread, noise, weights=(1.0, 1.0), contacts=None, zero=0.0):
    trial = Trial("one", "validate", time, measured, np.ones(measured.shape, bool), {}, zero)
    by_channel = np.sqrt(np.mean((simulated - measured) ** 2, axis=1)) / np.where(spread > 0, spread, 1.0)
    share = np.asarray(weights) / np.sum(weights)
    return judge(
        trial, by_channel @ share, by_channel[0], simulated[0], spread=spread, noise=noise,
        weights=np.asarray(weights), channels=CHANNELS, contacts=contacts,
    )  # fmt: skip


def _judged(offset=0.0, start=60, contacts=None, sets=1, seed=0):
    """Noise of 0.1 in both channels; from sample `start` on the prediction of z is off by `offset`."""
    source = np.random.default_rng(seed)
    time = 3.0 + np.arange(100) * 0.01
    truth = np.column_stack([np.sin(10 * time), np.cos(10 * time)])
    simulated = np.repeat(truth[None], sets, axis=0)
    simulated[:, start:, 1] += offset
    measured = truth + 0.1 * source.standard_normal(truth.shape)
    spread, noise = np.full(2, 0.7), np.full(2, 0.1)
    return _judge(time, measured, simulated, spread=spread, noise=noise, contacts=contacts, zero=3.05)


def test_the_true_model_scores_its_noise():
    found = _judged(sets=3)
    # 200 samples tell their own rms to 5 %.
    assert found.ratio == pytest.approx(1.0, abs=0.15)
    assert found.floor == pytest.approx(0.1 / 0.7)
    assert found.leaves is None
    assert len(found.nrmse) == 3
    assert reasons([found]) == ()


def test_a_prediction_leaves_where_it_is_off_for_good():
    found = _judged(offset=1.0, contacts=np.array([3.05, 3.2, 3.9]))
    assert found.leaves.model_dump() == {
        "time": pytest.approx(0.55), "channel": "z_B", "after_contacts": 2,
    }  # fmt: skip
    assert "fixed values are wrong" in reasons([found])[0]
    assert UNSEARCHED in reasons([found], ended=False)[0]
    assert "within their bands" in reasons([found], predicts=True, ended=False)[0]
    # Just below five deviations it may not leave but by the noise's own help, three times in a row.
    assert _judged(offset=0.1 * (LEAVES - 3)).leaves is None


def test_two_samples_are_no_departure():
    time = np.arange(50) * 0.01
    measured = np.zeros((50, 2))
    measured[20:22] = 10.0
    found = _judge(time, measured, np.zeros((1, 50, 2)), spread=np.ones(2), noise=np.full(2, 0.1))
    assert found.leaves is None
    assert found.nrmse_third_contact is None


def test_up_to_the_third_contact_nothing_later_counts():
    late = _judged(offset=2.0, start=60, contacts=np.array([3.05, 3.2, 3.55, 3.7]))
    assert late.third_contact == pytest.approx(0.5)
    assert late.ratio_third_contact == pytest.approx(1.0, abs=0.2)
    assert late.ratio > 5
    whole = _judged(offset=2.0, start=60, contacts=np.array([3.05, 3.2]))
    assert whole.ratio_third_contact == pytest.approx(whole.ratio)


def test_a_channel_without_weight_does_not_count():
    found = _judge(
        np.arange(50.0), np.zeros((50, 2)), np.stack([np.zeros(50), np.full(50, 9.0)], axis=-1)[None],
        spread=np.array([1.0, 0.0]), noise=np.array([0.1, np.nan]), weights=(1.0, 0.0),
    )  # fmt: skip
    assert found.nrmse[0] == 0.0
    assert found.floor == pytest.approx(0.1)
    assert found.leaves is None


def _sets(name, value, sigma=0.1, status="free"):
    record = ParameterRecord(
        "leg_mass", "m_leg", "kg", status, "Mass.", "test", 1.0, 0.1, 10.0, "linear", None
    )  # fmt: skip
    values = np.array([[value], [value + sigma * math.sqrt(2)]])
    return ParameterSets(
        kind="gear", name=name, parameters=(record,), values=values, nrmse=np.zeros(2), runs=(1, 2),
        seeds=(1, 2), at_bound=np.zeros((2, 1)), trials=(), uses=(), channels=(), channel_units=(),
        channel_weights=(), nrmse_by_trial=np.zeros((2, 0, 0)), settings={}, provenance={},
    )  # fmt: skip


def _document(value, low, high, opened=(False, False), doubt=None, stated=()):
    # The best set lies elsewhere than the minimum that its interval is around.
    row = FreeParameter.model_construct(
        name="leg_mass", value=5.0, refined=value, interval_95=[low, high], open_95=opened, doubt=doubt
    )
    return TrustDocument.model_construct(parameters=[row], stated=stated)


def _compare(first, second, documents):
    return compare_values(("a", "b"), [_sets("a", first), _sets("b", second)], documents, [None, None])[0]


@pytest.mark.parametrize(
    ("second", "documents", "allowed"),
    [
        # 1.0 reaches up to 1.3, 2.0 down to 1.6: together 0.5, the root of 0.09 + 0.16.
        (2.0, [_document(1.0, 0.0, 1.3), _document(2.0, 1.6, 9.0)], 0.5),
        (1.4, [_document(1.0, 0.0, 1.3), _document(1.4, 1.0, 9.0)], 0.5),
        # An interval from 1.2 to 1.3 ends before its value 1.4 on the side that faces b: it allows nothing.
        (2.0, [_document(1.4, 1.2, 1.3), _document(2.0, 1.6, 9.0)], 0.4),
    ],
)
def test_differences_are_judged_by_the_sides_that_face_each_other(second, documents, allowed):
    found = _compare(1.0, second, documents)
    assert found.allowed == pytest.approx(allowed)
    first = documents[0].parameters[0].refined
    assert found.differs is (second - first > allowed)
    assert found.difference == pytest.approx((second - first) / first)


@pytest.mark.parametrize(
    ("stated", "error", "contradicted", "name", "common"),
    [
        # 0.8 of the first error and 0.6 of the second are the scale's: 0.25 - 2 * 0.48 * 0.3 * 0.4 is left.
        (1.2, 0.01, False, "body_mass", 0.48),
        # Another scale's; a statement that has let go; slopes of two campaigns.
        (1.3, 0.01, False, "body_mass", 0.0),
        (1.2, 0.02, False, "body_mass", 0.0),
        (1.2, 0.01, True, "body_mass", 0.0),
        (1.2, 0.01, False, "slope[drop-1]", 0.0),
    ],
)
def test_an_error_that_both_campaigns_share_makes_no_difference(stated, error, contradicted, name, common):
    values = [
        StatedValue.model_construct(
            name=name, stated=value, error=size, sigma=left * size, contradicted=contradicted
        )
        for value, size, left in ((1.2, 0.01, 1.0), (stated, error, 0.75))
    ]
    documents = [_document(1.0, 0.0, 1.3, stated=values[:1]), _document(2.0, 1.6, 9.0, stated=values[1:])]
    sets = [_sets("a", 1.0), _sets("b", 2.0)]
    rho = 2 * [np.array([[1.0, 0.8], [0.8, 1.0]])]
    found = compare_values(("a", "b"), sets, documents, rho)[0]
    assert found.allowed == pytest.approx(math.sqrt(0.25 - 2 * common * 0.3 * 0.4))
    # A place that both state as 0 from where they state it is another one if they state it elsewhere.
    found = compare_values(("a", "b"), sets, documents, rho, [{}, {name: 0.05}])[0]
    assert found.allowed == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("documents", "doubt"),
    [
        ([_document(1.0, 0.0, 1.3), _document(2.0, 0.1, 9.0, (True, False))], "the interval is open in b"),
        ([_document(1.0, 0.9, 1.1, doubt="not converged"), _document(2.0, 1.9, 2.1)], "a: not converged"),
    ],
)
def test_an_open_or_doubtful_interval_judges_nothing(documents, doubt):
    found = _compare(1.0, 2.0, documents)
    assert (found.differs, found.doubt) == (None, doubt)
    # The same difference of another parameter shares the sentence, another reason has its own.
    others = ({"symbol": "k_h"}, {"symbol": "b_s", "doubt": "c: why"}, {"doubt": None})
    assert unjudged([found, *(found.model_copy(update=other) for other in others)]) == [
        f"not judged: m_leg, k_h ({doubt})",
        "not judged: b_s (c: why)",
    ]


def test_without_profiles_nothing_is_judged():
    found = _compare(1.0, 2.0, [None, None])
    assert found.by == "spread of the sets"
    # Far beyond the spread, which says only that the runs agree.
    assert found.differs is None
    assert "run sysid trust on a and b" in found.doubt
    assert found.allowed == pytest.approx(1.959964 * 0.1 * math.sqrt(2), rel=1e-6)
    fixed = compare_values(
        ("a", "b"), [_sets("a", 1.0, status="fixed"), _sets("b", 2.0)], *2 * [[None, None]]
    )
    assert fixed == []


def test_a_range_that_is_no_interval_judges_nothing_and_is_called_so():
    row = {
        "interval_95": [0.9, 1.1],
        "open_95": [False, False],
        "verdict": "well",
        "doubt": "a range of NRMSE",
    }
    sets = [replace(_sets(name, 1.0), settings={INTERVALS: {"leg_mass": row}}) for name in "ab"]
    assessed = TrustDocument.model_construct(parameters=[], stated=())
    (found,) = compare_values(("a", "b"), sets, [assessed, assessed], [None, None])
    assert found.differs is None
    assert found.doubt == "its interval is a range of NRMSE, by which no difference is judged"


def test_an_interval_under_a_guessed_scale_is_no_interval():
    row = {"interval_95": [0.9, 1.1], "open_95": [False, False], "verdict": "well"}
    sets = replace(_sets("a", 1.0), settings={INTERVALS: {"leg_mass": row}})
    known = sets.judged["leg_mass"]
    assert (known.words, known.interval) == ("well identifiable", "0.9 to 1.1")
    guessed = replace(sets, settings={**sets.settings, NOT_ALONE: ["leg_mass"]})
    known = guessed.judged["leg_mass"]
    assert (known.words, known.interval) == ("not identifiable", "open")
    assert guessed.known["leg_mass"].text() == "—"


def _write(folder, part, arrays=None, **content):
    """A document of trust or of a validation that holds nothing else."""
    head = {"part": part, "fit": "f", "kind": "gear", "warnings": []}
    head["campaign"] = {"file": "lab.toml", "sha256": 64 * "0"}
    judged = dict.fromkeys(("nrmse", "nrmse_fitted", "ratio", "ratio_third_contact"), math.nan)
    found = {"flagged": False, "reasons": [], "limits": {}, "trials": [], **judged}
    if part == "trust":
        spread = {"channels": [], "units": [], "trials": []}
        found = {"parameters": [], "correlation": [[1.0]], "noise": {"statement": "", "channels": []}}
        found |= {"trials": [], "notes": [], "spread": spread, "bootstrap": None}
        found |= {"evaluations": 0, "seconds": 0.0}
    model = TrustDocument if part == "trust" else ValidationDocument
    write_part(folder, model(**head | found | content), arrays or {})


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "fit.h5").write_bytes(b"a fit")
    return tmp_path


def test_a_part_is_read_back_until_the_fit_changes(folder):
    part = validation_part("my campaign/2")
    assert part == "validation-my-campaign-2"
    arrays = {"trials/1/time": (np.arange(100.0), "sample", "s")}
    _write(folder, part, arrays)
    found = ValidationDocument.read(folder, part)
    assert math.isnan(found.ratio)
    assert found.sha256["fit.h5"] == hashlib.sha256(b"a fit").hexdigest()
    assert read_arrays(folder, part)["trials/1/time"] == pytest.approx(np.arange(100.0))
    assert parts(folder) == (part,)
    (folder / f"{part}.h5").write_bytes(b"other arrays")
    with pytest.warns(SysidWarning, match=r"is not used: what it says is of another validation-\S+h5 than"):
        assert ValidationDocument.read(folder, part) is None
    (folder / "fit.h5").write_bytes(b"another fit")
    with pytest.warns(SysidWarning, match=r"is not used: what it says is of another fit.h5 than lies beside"):
        assert ValidationDocument.read(folder, part) is None
    assert TrustDocument.read(folder) is None


def _file(path, letter):
    return {"file": path.rpartition("/")[2], "sha256": 64 * letter, "from_fit_folder": path}


def test_two_campaigns_of_one_name_keep_both_validations(folder):
    part = validation_part("lab")
    first, second = _file("../a/lab.toml", "a"), _file("../b/lab.toml", "b")
    assert free_part(folder, part, first) == part
    _write(folder, part, campaign=first)
    assert free_part(folder, part, first) == part
    assert free_part(folder, part, second) == f"{part}-bbbbbbbb"
    # Systems that do not tell case apart would have one file of both.
    assert free_part(folder, validation_part("LAB"), second) == "validation-LAB-bbbbbbbb"
    # What spoke of another fit may go.
    (folder / "fit.h5").write_bytes(b"another fit")
    assert free_part(folder, part, second) == part


def test_an_edited_or_moved_campaign_replaces_its_own_validation(folder):
    part = validation_part("lab")
    second = f"{part}-bbbbbbbb"
    _write(folder, part, campaign=_file("../a/lab.toml", "a"))
    _write(folder, second, campaign=_file("../b/lab.toml", "b"))
    # A slope was mended in either file: nothing of the wrong one may stay beside the right one.
    assert free_part(folder, part, _file("../a/lab.toml", "c")) == part
    assert free_part(folder, part, _file("../b/lab.toml", "d")) == second
    # Even to what the other file says.
    assert free_part(folder, part, _file("../b/lab.toml", "a")) == second
    assert free_part(folder, part, _file("../moved/lab.toml", "b")) == second
    assert free_part(folder, part, _file("../third/lab.toml", "e")) == f"{part}-eeeeeeee"


def test_damaged_parts_are_refused(folder):
    _write(folder, "trust", {"correlation": (np.eye(2), "p, p", "1")})
    path = folder / "trust.json"
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole[: len(whole) // 2], encoding="utf-8")
    with pytest.raises(FitError, match="damaged or cut off"):
        TrustDocument.read(folder)
    path.write_text(exact_json.dumps({**exact_json.loads(whole), "version": 99}), encoding="utf-8")
    with pytest.raises(FitError, match="of version 99, expected 2"):
        TrustDocument.read(folder)
    for key in ("part", "sha256", "written"):
        kept = {name: value for name, value in exact_json.loads(whole).items() if name != key}
        path.write_text(exact_json.dumps(kept), encoding="utf-8")
        with pytest.raises(FitError, match=f"damaged or cut off .{key}: it is missing"):
            TrustDocument.read(folder)
    path.write_text(whole.replace('"fit": "', '"fit": "another '), encoding="utf-8")
    with pytest.raises(FitError, match=r"trust.json: has changed since sysid wrote it .*; restore it, or"):
        TrustDocument.read(folder)
    (folder / "trust.h5").write_bytes(b"no HDF5")
    with pytest.raises(FitError, match="damaged or cut off"):
        read_arrays(folder, "trust")
