"""What a fit is good for: bands, words, numbers that are read from drops and benches, refusals of maps."""

from dataclasses import replace

import numpy as np
import pytest

from fakes.landings import MOTOR
from fakes.published import table_2
from sysid.errors import ExportError
from sysid.export import export
from sysid.fit.story import Read
from sysid.parameter_sets import PREDICTS as KEY
from sysid.report.trust_tables import use_tables
from sysid.trust.documents import JudgedTrial, ValidationDocument
from sysid.trust.use import NOT, PREDICTS, ROUGHLY, NumberOfUse, class_of_use, judged_use, numbers_of_use
from sysid.workflows.landing_sources import open_fleets
from sysid.workflows.options import MotorOptions


def number(measured, what="rest place", half=1.0):
    return NumberOfUse(what=what, unit="cm", measured=measured, predicted=0.0, low=-half, high=half)


def test_a_band_is_of_the_draws_and_open_where_they_lack_the_number():
    draws = np.linspace(0.0, 10.0, 201)
    (found,) = numbers_of_use([Read("rest place", "cm", np.concatenate([[9.7, 5.1], draws]))])
    assert (found.low, found.high) == (0.25, 9.75)
    assert (found.measured, found.predicted, found.held) == (9.7, 5.1, True)
    draws[:10] = np.nan
    (found,) = numbers_of_use([Read("rest place", "cm", np.concatenate([[9.7, 5.1], draws]))])
    assert found.high == np.inf
    assert not found.held
    assert not numbers_of_use([Read("rest place", "cm", np.concatenate([[np.nan, 5.1], draws]))])


@pytest.mark.parametrize(("held", "word"), [(18, PREDICTS), (17, ROUGHLY), (15, ROUGHLY), (14, NOT)])
def test_the_word_is_the_share_of_the_numbers_that_the_bands_hold(held, word):
    numbers = [number(0.5 if i < held else 2.0) for i in range(20)]
    found = judged_use([(numbers[:7], None), (numbers[7:], None)], drawn=True)
    assert (found.word, found.held, found.count) == (word, held, 20)
    assert found.sentence.startswith(f"{word}: 95 % bands of draws hold {held} of 20 numbers of use")
    # Without draws, and of few numbers, there is no word.
    assert not judged_use([(numbers, None)], drawn=False).word
    assert not judged_use([(numbers[:4], None)], drawn=True).word


def test_a_class_counts_as_right_where_most_draws_have_it():
    rests = class_of_use(["at rest", "flipped", *["at rest"] * 6, *["flipped"] * 4])
    flips = class_of_use(["flipped", "flipped", *["at rest"] * 6, *["flipped"] * 4])
    assert (rests.predicted, rests.share, flips.predicted, flips.share) == ("at rest", 0.6, "at rest", 0.4)
    found = judged_use([([number(0.0)], rests), ([number(0.0, "touchdown, first")], flips)], drawn=True)
    assert (found.classes_right, found.classes, found.held, found.count) == (1, 2, 2, 2)
    assert [width.what for width in found.widths] == ["rest place", "touchdown"]


def test_the_tables_say_each_number_and_the_total():
    scores = dict.fromkeys(("floor", "ratio"), 1.0)
    early = dict.fromkeys(("nrmse_third_contact", "ratio_third_contact", "third_contact", "leaves"))
    numbers, ends = [number(0.5), number(3.0)], class_of_use(["at rest"] * 12)
    trial = JudgedTrial(
        name="drop-7", nrmse=[0.1], by_channel={}, **scores, **early, numbers=numbers, ends=ends
    )
    use = judged_use([(numbers, ends)], drawn=True)
    single, total = use_tables(ValidationDocument.model_construct(trials=[trial], use=use))
    text = [[cell.text for cell in row] for row in single.rows]
    assert text[0] == ["drop-7", "rest place", "cm", "0.5", "0", "-1 to 1"]
    assert text[1][-1] == "-1 to 1, not held"
    assert text[2] == ["drop-7", "end of the landing", "", "at rest", "at rest", "100 % of draws so"]
    assert [cell.text for cell in total.rows[0]] == ["rest place", "cm", "1.8", "1", "1 of 2"]


def test_a_map_refuses_sets_that_do_not_predict(tmp_path):
    """Also as a file: the word travels with the sets."""
    sets = table_2("lf")
    says = {"word": NOT, "sentence": f"{NOT}: 95 % bands of draws hold 3 of 20 numbers of use"}
    bad, good = tmp_path / "bad.json", tmp_path / "good.json"
    export(replace(sets, settings={**sets.settings, KEY: says}), bad)
    export(replace(sets, settings={**sets.settings, KEY: says | {"word": ROUGHLY}}), good)
    with pytest.raises(ExportError, match=r"bad\.json: does not predict: .* 3 of 20 .* add --anyway"):
        open_fleets(MotorOptions(motor=MOTOR), [bad])
    open_fleets(MotorOptions(motor=MOTOR), [good])
    open_fleets(MotorOptions(motor=MOTOR, anyway=True), [bad])
