"""What trust says: of what intervals take as exact, of trials that stand out, on the terminal."""

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.journal import Journal
from sysid.report.trust_tables import channel_line, check_lines, comparison_table, expected_table, noise_table
from sysid.trust.comparison import Comparison, Difference
from sysid.trust.documents import (
    ChannelNoise,
    CheckDocument,
    ExpectedParameter,
    FreeParameter,
    Noise,
    Partner,
    TrustDocument,
)
from sysid.trust.influence import Influence
from sysid.workflows.kinds import find_kind
from sysid.workflows.predict import _notice_unlike
from sysid.workflows.trust import _notice_trials


@pytest.mark.parametrize("kind", ["gear", "motor"])
def test_advice_on_an_odd_trial_fits_what_was_fitted(kind):
    words = find_kind(kind).words
    # Without the last trial the parameter is 0.3, outside.
    interval = {"interval_95": [0.4, 0.6], "open_95": [False, False], "verdict": "weakly"}
    rows = [FreeParameter.model_construct(name="p", symbol="p", refined=0.5, **interval)]
    odd = Influence(np.array([1.0, 1.0, 4.0]), np.full((3, 1), 0.3), np.array([[0.0], [0.0], [9.0]]))
    with Journal() as journal:
        _notice_trials(("a", "b", "c"), odd.without, odd, rows, {"p": []}, words, why="")
        judged = [SimpleNamespace(name=n, ratio=r) for n, r in zip("abc", odd.ratio, strict=True)]
        _notice_unlike(judged, words)
    sentences = journal.sentences()
    assert len(sentences) == 3
    of_drops = [
        word for word in ("bounce", "release", "slope") if any(word in sentence for sentence in sentences)
    ]
    assert of_drops == (["bounce", "release", "slope"] if kind == "gear" else [])
    # Inside its interval the move is no news: one sentence less.
    wide = [rows[0].model_copy(update={"interval_95": [0.2, 0.6]})]
    with Journal() as journal:
        _notice_trials(("a", "b", "c"), odd.without, odd, wide, {"p": []}, words, why="")
    assert not any("hangs on" in sentence for sentence in journal.sentences())


def test_two_ratios_of_one_channel_say_what_parts_them():
    channel = ChannelNoise(
        name="x_B", unit="m", residual=1.19e-3, floor=1e-3, samples=9, independent_samples=3.0
    )
    noise = Noise(statement="", channels=[channel])
    shown = noise_table(TrustDocument.model_construct(noise=noise))
    assert shown.title.endswith("with errors of the measured inputs")
    assert shown.rows[0][4].text == "1.19"
    assert "leaves out what errors of the measured inputs explain" in shown.caption


def test_a_parameter_that_no_channel_sees_is_told_by_nothing():
    shares = {
        "R": {"z_B_rate": 0.3, "speed": 0.7},
        "k_d": {"torque": 0.0, "speed": float("nan")},
        "L": dict.fromkeys("abcdef", 1 / 6),
    }
    rows = [ExpectedParameter.model_construct(symbol=name, channels=of) for name, of in shares.items()]
    line = channel_line(CheckDocument.model_construct(parameters=rows))
    assert line == "channels that determine each parameter most: R: speed 70 %, ż_B 30 %; k_d: nothing; L: a"


def test_a_check_names_parameters_by_symbol():
    row = ExpectedParameter.model_construct(
        name="joint_dz", symbol="dz_j", unit="m", value=0.02, half_width=0.1, half_width_over_bounds=0.1,
        verdict="well", partners=[Partner(name="joint_dx", correlation=0.9)],
    )  # fmt: skip
    other = row.model_copy(update={"name": "joint_dx", "symbol": "dx_j", "partners": []})
    shown = expected_table(CheckDocument.model_construct(campaign={"name": "c"}, parameters=[row, other]))
    assert shown.rows[0][-1].text == "dx_j +0.90"


def test_a_difference_and_what_is_allowed_have_one_unit():
    row = Difference.model_construct(
        symbol="R", unit="Ω", fits=["a", "b"], values=[0.2, 0.201], difference=0.005, allowed=0.002,
        by="profile intervals", differs=False,
    )  # fmt: skip
    shown = comparison_table(Comparison.model_construct(differences=[row]))
    cells = {column.title: cell.text for column, cell in zip(shown.columns, shown.rows[0], strict=True)}
    assert (cells["difference [%]"], cells["allowed [%]"], cells["real"]) == ("0.5", "± 1.0", "no")


def test_a_second_log_is_said_by_its_clock():
    second = {
        "log": "rpm.csv", "sha256": "0" * 64, "format": "tacho", "device": None, "aligned": "a with b",
        "offset": 0.12345678, "correlation": 0.99123456, "confidence": 0.87654321, "notes": ["one"],
    }  # fmt: skip
    quality = [{"name": "forward-1", "second_log": second}]
    line = check_lines(CheckDocument.model_construct(quality=quality, excitation={}))[0]
    assert line == "forward-1: second log rpm.csv: clock offset 0.1235 s, confidence 0.8765"
