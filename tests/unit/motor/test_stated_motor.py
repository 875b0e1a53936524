"""Values that a motor campaign and its static logs state with errors: what moves, and what that does."""

import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from fakes.lab import MOTOR_LAB, misstated, scaled
from fakes.motor_bench import bench_of, edited, problem_of
from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.errors import CampaignError, LogError
from sysid.motor import known_values
from sysid.motor.known_values import _check_kv_at_full_command
from sysid.motor.model import PARAMETERS, thrust
from sysid.synthetic.motor import TrialPlan, synthesize_motor
from sysid.trials.steady import SteadyPoints
from sysid.workflows.check import check_campaign

SHORT = (
    TrialPlan("forward-1", "forward", "fit", 0.25, (0.62, 0.35, 0.80), 0.45, "csv"),
    TrialPlan("reverse-1", "reverse", "fit", -0.25, (-0.60, -0.35, -0.90), 0.45, "hdf5"),
)
CURVES = [
    f"{curve}_{place}_{way}"
    for way in ("forward", "reverse")
    for curve in ("torque_curve", "no_load_line")
    for place in ("top", "middle")
]
CELLS = ["load_cell_factor_static", "load_cell_factor_trials"]


def unstated(path):
    """The same campaign without errors."""
    source = path.with_name("campaign.toml")
    return misstated(source, 0, name="unstated.toml", errors=MOTOR_LAB, written=False)


@pytest.fixture
def path(tmp_path):
    bench = synthesize_motor(tmp_path / "bench", seed=3, trials=SHORT)
    return misstated(bench / "campaign.toml", 0, name="stated.toml", errors=MOTOR_LAB)


def row_of(problem, **values):
    """The row of what a campaign states, and of some other values."""
    row = problem.base.copy()
    for name, value in values.items():
        row[problem.space.table.index[name]] = value
    return row[None]


def signals(problem, **values):
    """Predicted torque and speed of the first trial."""
    return problem.predict(row_of(problem, **values)).signals[0][0]


@pytest.mark.parametrize(
    ("command", "current", "accused"),
    [
        # The torque of the current at Kv 960 rpm/V less 2 % of friction; then that of 1150 rpm/V.
        (1.0, 1.02, False),
        (1.0, 0.83, True),
        # At a duty below 1 the supply gives less than the motor has; a sensor that is off gives nothing.
        (0.9, 0.83, False),
        (1.0, 0.0, False),
        # Within the errors of Kv and cell.
        (1.0, 0.93, False),
    ],
)
def test_a_kv_is_held_against_the_current_at_full_command(path, recwarn, command, current, accused):
    campaign, torque = read_campaign(path), np.array([-0.07, 0.09, 0.092])
    currents = np.array([0.0, *2 * [current]]) * np.abs(torque) * float(campaign.motor.kv)
    unknown, none = np.full(3, np.nan), np.zeros(3, dtype=np.int64)
    points = SteadyPoints(
        np.array([-0.8, command, command]), unknown, unknown, torque, unknown, currents, none, none, none
    )
    recwarn.clear()
    _check_kv_at_full_command(campaign, points)
    assert [("rpm/V at most" in str(one.message)) for one in recwarn] == [True] * accused


@pytest.mark.parametrize("commanded", [True, False])
def test_without_commands_no_current_is_held_against_a_kv(tmp_path, monkeypatch, recwarn, commanded):
    """Where no command is logged, the largest speed of a log counts as full command, at any duty."""
    path = shutil.copytree(SAMPLES / "motor", tmp_path / "motor") / "campaign.toml"
    path = edited(path, ("^kv = .*", 'kv = "1150 rpm/V"'))
    read = known_values.read_curve_logs
    monkeypatch.setattr(
        known_values, "read_curve_logs",
        lambda *given: tuple(replace(log, commanded=commanded) for log in read(*given)),
    )  # fmt: skip
    bench_of(path)
    assert any("rpm/V at most" in str(one.message) for one in recwarn) is commanded


def test_what_was_measured_moves(path):
    campaign, bench = bench_of(path)
    space = problem_of(campaign, bench).space
    measured = ("back_emf_constant", "rotor_inertia", "reference_voltage")
    assert {*space.stated} == {*measured, *CURVES, *CELLS}
    # The errors as stated; curves state their own.
    shares = [space.stated[name].error / space.stated[name] for name in measured]
    assert shares == pytest.approx([0.02, 0.05, 0.005], rel=1e-3)
    assert {name for name, value in space.stated.items() if value.assumed} == {*CELLS}
    # A campaign that states no error has the typical ones, which are those of this lab.
    assumed = problem_of(*bench_of(unstated(path))).space.stated
    assert {*assumed} == {*measured, *CURVES, *CELLS}
    assert [assumed[name].assumed for name in (*measured, *CELLS)] == ["2 %", "5 %", "0.5 %", "1 %", "1 %"]
    assert [assumed[name].error / assumed[name] for name in measured] == pytest.approx(shares, rel=1e-3)
    assert [row.name for row in space.found] == [
        "winding_resistance", "winding_inductance", "viscous_damping", "command_delay[forward-1.csv]",
        "command_delay[reverse-1.h5]",
    ]  # fmt: skip
    inertia = ("^rotor_inertia = .*", 'rotor_inertia = "2.7e-5 kg·m² exact"')
    path = edited(path, ("^kv = .*", 'kv = "960 ± 10 rpm/V"'), inertia)
    space = problem_of(*bench_of(path)).space
    assert space.stated["back_emf_constant"].error / space.stated["back_emf_constant"] == pytest.approx(
        1 / 96
    )
    assert "rotor_inertia" not in space.stated
    fixed = '[parameters.fixed]\nviscous_damping = "1e-8 ± 5e-9 N·m·s/rad"\n[parameters.measured]\n'
    fixed += 'reference_voltage = ["11.0 V", "11.2 V"]\n[fit]\nexact = false\n'
    space = problem_of(*bench_of(edited(path, (r"^\[fit\]\n", fixed), name="ranged.toml"))).space
    assert space.stated["viscous_damping"].error == 5e-9
    # An error that is stated counts before a range, which is a uniform density.
    assert space.stated["reference_voltage"].error == pytest.approx(0.0555, rel=1e-3)
    plain = (r"^reference_voltage = .*± .*", 'reference_voltage = "11.1 V"')
    path = edited(path, plain, (r"^\[fit\]\n", fixed))
    space = problem_of(*bench_of(path)).space
    assert space.stated["reference_voltage"].error == pytest.approx(0.2 / math.sqrt(12))
    exact = edited(path, ("exact = false", "exact = true"))
    assert not problem_of(*bench_of(exact)).space.stated


@pytest.mark.usefixtures("unranked")
def test_check_says_whose_error_decides(path):
    heard = []
    found = check_campaign(unstated(path), say=heard.append, details=True)
    # R goes as k²: its half-width is twice that of a Kv known to 2 %. Two load cells of 1 % add 0.7 %.
    half_width = next(row.half_width for row in found.parameters if row.name == "winding_resistance")
    assert half_width == pytest.approx(2 * 1.96 * 0.02, rel=0.05)
    (worth,) = [one for one in found.sentences if one.startswith("measured four times better")]
    assert re.search(r"kv \(R ± 7\.9 % -> ± 2(\.\d)? %", worth)
    (idle,) = [one for one in found.sentences if one.startswith("measured better")]
    assert "rotor_inertia, static curves" in idle
    assert "kv" not in idle
    told = "assumed errors, within which these are fitted: reference_voltage 0.5 %, kv 2 %, rotor_inertia 5 %"
    assert any(told in line for line in heard)


def test_a_moved_value_is_the_value_stated_there(path):
    plain = problem_of(*bench_of(path))
    for key, text, values in (
        ("kv", "940 rpm/V", {"back_emf_constant": 30 / math.pi / 940}),
        ("rotor_inertia", "2.9e-5 kg·m²", {"rotor_inertia": 2.9e-5}),
        ("reference_voltage", "11.3 V", {"reference_voltage": 11.3}),
    ):
        there = edited(path, (f"^{key} = .*", f'{key} = "{text}"'), name="there.toml")
        moved, stated = signals(plain, **values), signals(problem_of(*bench_of(there)))
        assert np.max(np.abs(moved - signals(plain))[:, 1]) > 0.05, key
        np.testing.assert_allclose(moved, stated, rtol=1e-6, atol=1e-7)


def test_a_static_log_moves_its_curve(path):
    plain = problem_of(*bench_of(path))
    index = plain.space.table.index
    for column, log, names in (
        ("Torque", "static-forward.csv", ("torque_quadratic_forward", "torque_linear_forward")),
        ("Motor Optical", "no-load-reverse.csv", ("no_load_slope_reverse", "no_load_intercept_reverse")),
    ):
        file = path.with_name(log)
        before = file.read_bytes()
        scaled(file, column, 1.01)
        there = problem_of(*bench_of(path))
        file.write_bytes(before)
        columns = [index[name] for name in names]
        wanted = there.complete(row_of(there))[0, columns]
        (curve,) = (one for one in plain.bench.measured_curves if {*one.fit.parameters} == {*names})
        shares = 1 + np.linalg.solve(curve.changes.T, wanted - curve.fit.coefficients)
        assert shares[0] == pytest.approx(1.01, abs=1e-4)
        named = dict(zip((row.name for row in curve.rows), shares, strict=True))
        assert plain.complete(row_of(plain, **named))[0, columns] == pytest.approx(wanted, rel=1e-9)
        # Two independent rows have the covariance of the two coefficients, but for the tails of few points.
        moves = curve.changes * np.array(curve.errors)[:, None]
        ratio = moves.T @ moves / curve.fit.covariance
        assert np.ptp(ratio) == pytest.approx(0, abs=1e-6)
        # Student's t at one in a thousand with 18 degrees of freedom: 3.61 instead of 3.09.
        assert ratio[0, 0] == pytest.approx((3.61 / 3.09) ** 2, rel=0.05)


@pytest.mark.parametrize("bare", [True, False])
def test_a_factor_of_a_load_cell_is_a_log_of_another_scale(bare, path):
    if not bare:
        # The no-load speed then follows R and the drag of the static logs, by the map of their levels.
        text = re.sub(r"(?s)\nno_load = \[.*?\n\]", "", path.read_text(encoding="utf-8"))
        path.write_text(text, encoding="utf-8")
    plain = problem_of(*bench_of(path))
    assert bool(plain.bench.curves.maps) != bare
    moved = signals(plain, load_cell_factor_static=1.03)
    assert np.max(np.abs(moved / signals(plain) - 1)) > 0.01
    for way in ("forward", "reverse"):
        scaled(path.with_name(f"static-{way}.csv"), "Torque", 1.03)
    np.testing.assert_allclose(moved, signals(problem_of(*bench_of(path))), rtol=1e-4, atol=1e-5)
    # What a load cell shows is too little by the factor; the speed is none of its business.
    shown = signals(plain, load_cell_factor_trials=1.02) / signals(plain)
    np.testing.assert_allclose(shown - [1 / 1.02, 1], 0, atol=1e-12)


def test_load_cells_are_exact_where_their_error_is_none(path):
    path = edited(path, (r"^\[fit\]", '[log]\ncalibration_error = "0.5 %"\n[fit]'))
    stated = problem_of(*bench_of(path)).space.stated
    for name in CELLS:
        assert (stated[name], stated[name].error, stated[name].assumed) == (1, 0.005, "")
    exact = edited(path, ('"0.5 %"', '"0 %"'))
    assert {*stated} - {*problem_of(*bench_of(exact)).space.stated} == {*CELLS}


def test_what_follows_is_completed_once(path):
    problem = problem_of(*bench_of(path))
    drawn = problem.space.full(np.random.default_rng(1).random((4, len(problem.space.free))))
    whole = problem.complete(drawn)
    np.testing.assert_array_equal(problem.complete(whole), whole)
    column = problem.space.table.index
    np.testing.assert_array_equal(whole[:, column["torque_constant"]], whole[:, column["back_emf_constant"]])


def test_a_supply_that_every_log_reads_does_not_count(path):
    # Points without volts and trials without volts: the reference cancels.
    for log in ("no-load-forward.csv", "no-load-reverse.csv"):
        scaled(path.with_name(log), "Voltage", 0.0)
    space = problem_of(*bench_of(path)).space
    assert "reference_voltage" not in space.stated
    assert "back_emf_constant" in space.stated


def test_curves_of_the_trials_themselves_measure_nothing_beside_them(path):
    text = re.sub(r"(?s)\[curves\].*?(?=\[fit\])", "", path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")
    problem = problem_of(*bench_of(path))
    assert {*problem.space.stated} == {"back_emf_constant", "rotor_inertia"}
    # Their errors are disturbances of the intervals.
    assert problem.common >= 2


@pytest.mark.parametrize(("key", "text", "words"), [
    ("kv", '"960 ± -20 rpm/V"', "motor.kv: the error in '960 ± -20 rpm/V' is negative"),
    ("kv", '"960 ± 2000 rpm/V"', "motor.kv: the error in '960 ± 2000 rpm/V' is larger than the value"),
    ("kv", '"960 rpm/V ± 2 V"', "motor.kv: the error in '960 rpm/V ± 2 V': unit 'V' is not a 'rad/s/V'"),
    ("kv", '"960 ± 20"', "motor.kv: '960' has no unit; write kv = "),
    ("rotor_inertia", '"2.7e-5 kg·m² ± 1 g"', "motor.rotor_inertia: the error in "),
    ("rotor_inertia", '"2.7e-5 kg·m² ± some"', "motor.rotor_inertia: the error in "),
    ("reference_voltage", '"11.1 ± 200 %"', "motor.reference_voltage: "),
    ("unit", '"us ± 1"', "command.unit: "),
    ("minimum", '"1000 ± 5"', "command.minimum: expected a number, found '1000 ± 5'"),
    ("direction", '"forward ± 1"', "trials['forward-1'].direction: "),
    ("start", '"20 s ± 1 ms"', "trials['forward-1'].start: '20 s ± 1 ms' states an error"),
])  # fmt: skip
def test_an_error_that_cannot_be_is_refused_with_its_key(key, text, words, path):
    written = re.sub(rf"(?m)^{key} = [^#\n]*", f"{key} = {text} ", path.read_text(encoding="utf-8"), count=1)
    path.write_text(written, encoding="utf-8")
    with pytest.raises(CampaignError) as refusal:
        read_campaign(path)
    assert str(refusal.value).startswith(f"{path}: {words}"), str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_dead_band_states_no_error(path):
    path = edited(path, (r"^\[command\]", 'saturation_current = "0.35 ± 0.01 A"\n[command]'))
    with pytest.raises(CampaignError, match=r"motor\.saturation_current: '0\.35 ± 0\.01 A' states an error"):
        read_campaign(path)


def test_a_lab_states_what_it_draws(path):
    lab = misstated(path.with_name("campaign.toml"), 1, name="lab.toml", errors=MOTOR_LAB)
    assert len(re.findall(" ± ", lab.read_text(encoding="utf-8"))) == len(MOTOR_LAB)


def test_a_set_with_moved_curves_drives_the_motor_model(path):
    problem = problem_of(*bench_of(path))
    (row,) = row_of(problem)
    values = dict(zip(problem.space.table, row.tolist(), strict=True))
    assert {*CURVES} <= {*values}
    expected = PARAMETERS.filled({name: value for name, value in values.items() if name in PARAMETERS})
    assert PARAMETERS.filled(values) == expected
    assert thrust(800.0, values) > 1.0


@pytest.mark.parametrize(("table", "log", "other", "words"), [
    ("static", "static-forward", "no-load-forward", "name it under curves.no_load"),
    ("no_load", "no-load-forward", "static-forward", "name it under curves.static"),
    ("static", "static-forward", "static-reverse", "whose commands run from u = -1 to 0"),
])  # fmt: skip
def test_a_log_of_another_curve_is_refused(table, log, other, words, path):
    text = path.read_text(encoding="utf-8")
    text = re.sub(rf'\{{ log = "{other}.csv".*?\}},', "", text)
    path.write_text(text.replace(f"{log}.csv", f"{other}.csv"), encoding="utf-8")
    with pytest.raises(LogError, match=rf"{other}\.csv.*({words})"):
        bench_of(path)


def test_commands_in_percent_are_the_same_commands(tmp_path):
    pulses = synthesize_motor(tmp_path / "bench", seed=3, trials=SHORT[:1]) / "campaign.toml"
    shutil.copytree(pulses.parent, tmp_path / "percent")
    for log in (tmp_path / "percent").glob("*.csv"):
        head, *lines = log.read_text(encoding="utf-8-sig").splitlines()
        rows = [line.split(",") for line in lines if line]
        for row in rows:
            row[1] = f"{(float(row[1]) - 1500) / 5:.9f}"
        head = head.replace("Command (µs)", "Command (%)").replace("ESC signal (µs)", "ESC signal (%)")
        log.write_text("\n".join([head, *(",".join(row) for row in rows), ""]), encoding="utf-8")
    numbers = [("us", "%"), ("1000", "-100"), ("1500", "0"), ("2000", "100")]
    names = ("unit", "minimum", "neutral", "maximum")
    pairs = [
        (f'^{key} = "?{a}"?', f'{key} = "{b}"' if key == "unit" else f"{key} = {b}")
        for key, (a, b) in zip(names, numbers, strict=True)
    ]
    (_, there), (_, here) = (bench_of(edited(tmp_path / at / "campaign.toml", *edits, name="forward.toml"))
                             for at, edits in (("percent", pairs), ("bench", [])))  # fmt: skip
    assert there.fitted[0].log.recording["command"].unit == "%"
    assert there.fitted[0].log.steps.level == pytest.approx(here.fitted[0].log.steps.level, abs=1e-9)
    for one, other in zip(there.curves.fits, here.curves.fits, strict=True):
        assert dict(one.parameters) == pytest.approx(dict(other.parameters), rel=1e-6)


@pytest.mark.parametrize(("column", "factor", "words"), [
    (3, 101.97, r"its thrust is 0\.0098\d* times"),
    (4, 1000.0, r"its torque is 0\.0009\d+ times"),
    (2, 9.549, r"its torque is 9\d\.\d times"),
])  # fmt: skip
def test_a_trial_in_another_unit_than_the_static_curve_is_named(column, factor, words, path):
    log = path.with_name("forward-1.csv")
    head, *lines = log.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines]
    for row in rows:
        row[column] = f"{factor * float(row[column]):.5f}"
    log.write_text("\n".join([head, *(",".join(row) for row in rows), ""]), encoding="utf-8")
    seen = pytest.warns(UserWarning, match=words) if column == 3 else pytest.raises(LogError, match=words)
    with seen as found:
        bench_of(path)
    sentence = str(
        found.value if column != 3 else [w.message for w in found if re.search(words, str(w.message))]
    )
    assert re.search("of forward-1 at the same speed.*correct the unit of", sentence)


def test_the_trial_that_differs_from_curve_and_other_trials_is_named(tmp_path):
    trials = (*SHORT, replace(SHORT[0], name="forward-2"))
    path = synthesize_motor(tmp_path / "bench", seed=3, trials=trials) / "campaign.toml"
    bench_of(path)
    log = path.with_name("forward-2.csv")
    head, *lines = log.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines]
    log.write_text(
        "\n".join(
            [head, *(",".join([*row[:3], f"{101.97 * float(row[3]):.2f}", row[4]]) for row in rows), ""]
        ),
        encoding="utf-8",
    )
    with pytest.warns(UserWarning, match="'forward-2': its thrust is 102 times that of forward-1, static"):
        bench_of(path)


def test_thrust_curves_are_drawn_with_the_error_of_the_load_cell(path):
    problem = problem_of(*bench_of(path))
    drawn = problem.unmoved
    assert [names[0] for names in drawn] == ["thrust_quadratic_forward", "thrust_quadratic_reverse"]
    values = {name: value for fit in problem.bench.curves.fits for name, value in fit.parameters.items()}
    for (quadratic, _), covariance in drawn.items():
        assert 0.01 < math.sqrt(covariance[0, 0]) / values[quadratic] < 0.02


@pytest.mark.parametrize(("key", "text", "words"), [
    ("rotor_inertia", "0.027 kg·m²", r"rotor_inertia = 0\.027 kg·m² is 1e\+03 × the 2\.\d+e-05 kg"),
    ("rotor_inertia", "2.7e-8 kg·m²", r"rotor_inertia = 2\.7e-08 kg·m² is 0\.001 × the"),
    ("reference_voltage", "11.1 mV", r"reference_voltage = 0\.0111 V is 0\.001 × the 11\.1 V"),
    ("kv", "0.96 rpm/V", "motor.kv: .* correct kv or reference_voltage, and their units"),
])  # fmt: skip
def test_a_slip_of_a_unit_is_refused(key, text, words, path):
    there = edited(path, (f"^{key} = .*", f'{key} = "{text}"'), name="there.toml")
    with pytest.raises(CampaignError, match=words):
        bench_of(there)


def test_every_log_has_a_delay_and_no_campaign_chooses_a_common_one(path):
    text = path.read_text(encoding="utf-8")
    path.write_text(f'{text}\n[nuisance]\ncommand_delay = "log"\n', encoding="utf-8")
    assert read_campaign(path).trials
    path.write_text(f'{text}\n[nuisance]\ncommand_delay = "common"\n', encoding="utf-8")
    with pytest.raises(CampaignError, match="unknown key nuisance; "):
        read_campaign(path)
