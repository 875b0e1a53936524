"""Numbers by the names of simulators: each target's own law, written out, gives back the motor's motion."""

import ast
import math
import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sysid
from fakes.published import table_1, table_2
from sysid.errors import ExportError
from sysid.export import export
from sysid.export.numbers import TARGETS, numbers_for
from sysid.fit.adequacy import NOT_BY
from sysid.motor.model import PARAMETERS, aerodynamic_torque, simulate, steady_state, thrust
from sysid.motor.nearest_lag import STEPS, FirstOrderRotor

# The paper's motor, and one with a propeller that brakes more than it can drive: its lag down is longer.
MOTORS = {
    "paper": {},
    "brake": {
        "torque_quadratic_forward": 6e-7, "thrust_quadratic_forward": 4e-5, "thrust_linear_forward": -2e-3,
    },
}  # fmt: skip
# Room for what the steps of the integrations below add to a stated error [1].
ROOM = 2e-3


def sets_of(**values):
    """The published set with other values."""
    sets = table_1()
    row = sets.values.copy()
    for name, value in values.items():
        row[0, sets.column(name)] = value
    return replace(sets, values=row)


@pytest.fixture(params=MOTORS)
def motor(request):
    return sets_of(**MOTORS[request.param])


def errors_of(numbers):
    """Departures from its law that a target's text states, by number [1]."""
    laws = {row.name: row.law for row in numbers.rows}
    return {
        n: float(law.split("off by ")[1].split(" %")[0]) / 100 for n, law in laws.items() if "off by" in law
    }


def response(values, before, after):
    """The motor's own speed after a step of the command, its clock, and the speeds around the step."""
    current, speed = (float(value) for value in steady_state(before, values))
    clock = np.arange(0.0, 0.6005, 1e-3)
    run = simulate(values, [0.0], [after], clock, initial=(current, speed))
    return clock, run.speed, speed, float(steady_state(after, values)[1])


def misses(values, law, steps):
    """Rms distance of a law's responses from the motor's, over the steps [1]."""
    shares = []
    for before, after in steps:
        clock, speed, start, end = response(values, before, after)
        shares.append((law(clock, start, end) - speed) / (end - start))
    return float(np.sqrt(np.mean(np.square(shares))))


def motion_of(sets):
    values = {name: value for name, value in sets.best.items() if name in PARAMETERS}
    return values, np.linspace(0.0, float(steady_state(1.0, values)[1]), 200)


def test_gazebo_s_law_gives_back_the_motor(motor):
    numbers = numbers_for(motor, "gazebo")
    root = ElementTree.fromstring(f"<plugin>{numbers.text()}</plugin>")
    p = {element.tag: float(element.text) for element in root}

    def gazebo(clock, start, command):
        # FirstOrderFilter and the thrust of MulticopterMotorModel.cc, at its steps of 1 ms.
        speed, out = start, []
        for _ in clock:
            out.append(speed)
            constant = p["timeConstantUp"] if command > speed else p["timeConstantDown"]
            alpha = math.exp(-1e-3 / constant)
            speed = alpha * speed + (1.0 - alpha) * min(command, p["maxRotVelocity"])
        return np.array(out)

    values, speed = motion_of(motor)
    stated = errors_of(numbers)
    up, down = misses(values, gazebo, STEPS), misses(values, gazebo, [(b, a) for a, b in STEPS])
    assert up == pytest.approx(stated["timeConstantUp"], abs=ROOM)
    assert down == pytest.approx(stated["timeConstantDown"], abs=ROOM)
    # The two are not one: each is nearest to its own steps.
    p["timeConstantUp"], p["timeConstantDown"] = p["timeConstantDown"], p["timeConstantUp"]
    assert misses(values, gazebo, STEPS) > up
    assert p["maxRotVelocity"] == pytest.approx(speed[-1], rel=1e-5)
    force = thrust(speed, values)
    off = np.abs(p["motorConstant"] * speed**2 - force).max() / force[-1]
    assert off == pytest.approx(stated["motorConstant"], abs=ROOM)
    torque = p["momentConstant"] * p["motorConstant"] * speed[-1] ** 2
    assert torque == pytest.approx(float(aerodynamic_torque(speed[-1], values)), rel=1e-4)
    assert p["rollingMomentCoefficient"] == p["rotorDragCoefficient"] == 0.0


def test_rotorpy_s_law_gives_back_the_motor(motor):
    numbers = numbers_for(motor, "rotorpy")
    p = ast.literal_eval("{" + "".join(line for line in numbers.text().splitlines() if line[0] != "#") + "}")
    values, speed = motion_of(motor)

    def rotorpy(clock, start, command):
        run = solve_ivp(
            lambda _, w: (command - w) / p["tau_m"], clock[[0, -1]], [start], t_eval=clock, rtol=1e-8
        )
        return run.y[0]

    # One time constant for both ways costs at most its distance from either: x e^-x is below 0.37.
    stated = errors_of(numbers_for(motor, "gazebo"))
    apart = float(numbers.to_frame().law["tau_m"].split("by ")[1].split(" %")[0]) / 100
    for steps, lag in ((STEPS, "timeConstantUp"), ([(b, a) for a, b in STEPS], "timeConstantDown")):
        assert misses(values, rotorpy, steps) <= stated[lag] + 0.37 * apart + ROOM
    assert p["k_eta"] * speed[-1] ** 2 == pytest.approx(
        thrust(speed[-1], values), rel=0.005 + stated["motorConstant"]
    )
    assert p["k_m"] * speed[-1] ** 2 == pytest.approx(float(aerodynamic_torque(speed[-1], values)), rel=1e-4)
    assert p["rotor_speed_max"] == pytest.approx(speed[-1], rel=1e-5)


def test_crazyflow_s_law_in_rpm_gives_back_the_motor(motor):
    numbers = numbers_for(motor, "crazyflow")
    p = tomllib.loads(numbers.text())
    values, speed = motion_of(motor)
    rpm = speed * 30 / np.pi
    for curve, exact in (("rpm2thrust", thrust), ("rpm2torque", aerodynamic_torque)):
        a, b, c = p[curve]
        np.testing.assert_allclose(a + b * rpm + c * rpm**2, exact(speed, values), rtol=1e-4, atol=1e-5)
    k = p["rotor_dyn_coef"]

    def crazyflow(clock, start, command):
        start, command = start * 30 / np.pi, command * 30 / np.pi

        def rate(_, w):
            up = k[0] * (command - w) + k[1] * (command**2 - w**2)
            return np.where(command > w, up, k[2] * (command - w) + k[3] * (command**2 - w**2))

        run = solve_ivp(rate, clock[[0, -1]], [start], t_eval=clock, rtol=1e-8)
        return run.y[0] * np.pi / 30

    stated = errors_of(numbers)
    assert misses(values, crazyflow, STEPS) == pytest.approx(stated["rotor_dyn_coef[0]"], abs=ROOM)
    down = misses(values, crazyflow, [(b, a) for a, b in STEPS])
    assert down == pytest.approx(stated["rotor_dyn_coef[2]"], abs=ROOM)
    assert p["prop_inertia"] == values["rotor_inertia"]
    assert p["thrust_max"] == pytest.approx(float(thrust(speed[-1], values)), rel=1e-5)


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_a_flight_controller_s_curve_makes_thrust_linear(motor, target):
    numbers = numbers_for(motor, target)
    lines = [line for line in numbers.text().splitlines() if not line.startswith("#")]
    if target == "px4":
        p = {line.split("\t")[2]: float(line.split("\t")[3]) for line in lines}
        factor, low, high = p["THR_MDL_FAC"], 0.0, 1.0
    else:
        p = {name: float(value) for name, value in (line.split(",") for line in lines)}
        factor, low, high = p["MOT_THST_EXPO"], p["MOT_SPIN_MIN"], p["MOT_SPIN_MAX"]
    wanted = np.linspace(0.0, 1.0, 101)
    # FunctionMotors.hpp and AP_Motors_Thrust_Linearization.cpp solve wanted = f x² + (1 - f) x.
    x = (factor - 1 + np.sqrt((1 - factor) ** 2 + 4 * factor * wanted)) / (2 * factor)
    values, _ = motion_of(motor)
    force = thrust(steady_state(low + (high - low) * x, values)[1], values)
    given = (force - force[0]) / (force[-1] - force[0])
    (stated,) = errors_of(numbers).values()
    assert np.abs(given - wanted).max() == pytest.approx(stated, abs=ROOM)
    # Without the curve thrust is far from linear.
    raw = thrust(steady_state(low + (high - low) * wanted, values)[1], values)
    assert np.abs((raw - raw[0]) / (raw[-1] - raw[0]) - wanted).max() > 2 * stated
    if target == "px4":
        assert p["CA_ROTOR0_CT"] == pytest.approx(force[-1], rel=1e-5)


def test_a_thrust_of_second_degree_in_the_command_has_its_own_expo():
    # Without drag the speed is the no-load speed, a line in the command: t = x² as thrust is Ω².
    values = {"torque_quadratic_forward": 1e-14, "torque_linear_forward": 0.0, "viscous_damping": 1e-14}
    sets = sets_of(**values, no_load_intercept_forward=0.0)
    assert numbers_for(sets, "px4").rows[0].value == pytest.approx(1.0, abs=1e-4)
    # Between 0.15 and 0.95 of it: (0.15 + 0.8 x)² over its range is x (0.24 + 0.64 x)/0.88.
    assert numbers_for(sets, "ardupilot").rows[0].value == pytest.approx(0.64 / 0.88, abs=1e-4)
    # A thrust linear in the command: PX4 takes no factor below 0.
    bent = sets_of(
        **values, no_load_intercept_forward=0.0, thrust_quadratic_forward=-2e-6, thrust_linear_forward=0.01
    )
    assert numbers_for(bent, "px4").rows[0].value == 0.0
    assert -1.0 <= numbers_for(bent, "ardupilot").rows[0].value < 0.0


# What a fit states beside its values: static curves with errors, intervals of parameters.
CURVES = [
    {"quantity": "thrust", "direction": "forward", "standard_errors": [3e-8, 2e-5], "correlation": -0.96},
    {"quantity": "torque", "direction": "forward", "standard_errors": [6e-10, 4e-7], "correlation": -0.9},
    {"quantity": "no_load", "direction": "forward", "standard_errors": [2.0, 1.0], "correlation": -0.9},
]
JUDGED = {
    name: {"interval_95": ends, "open_95": [False, False], "verdict": "well", "doubt": None}
    for name, ends in (
        ("winding_resistance", [0.29, 0.308]), ("winding_inductance", [0.0036, 0.0040]),
        ("viscous_damping", [1e-10, 2e-8]),
    )
}  # fmt: skip


def assessed(intervals=JUDGED, **more):
    return replace(table_1(), settings={"static_curves": CURVES, "intervals": intervals, **more})


def spread(number, draws):
    """95 % half-width of a number over drawn values of the parameters."""
    values = dict(table_1().best)
    return 1.96 * np.std([number.value(FirstOrderRotor(values | draw)) for draw in draws])


@pytest.mark.parametrize("name", ["motorConstant", "momentConstant", "maxRotVelocity", "timeConstantDown"])
def test_intervals_are_those_of_drawn_parameters(name):
    sets, random = assessed(), np.random.default_rng(3)
    number = next(number for number in TARGETS["gazebo"].numbers if number.name == name)
    draws = []
    for _ in range(300):
        draw = {
            key: random.normal(sets.best[key], np.ptp(row["interval_95"]) / 2 / 1.96)
            for key, row in JUDGED.items()
        }
        draw["viscous_damping"] = max(draw["viscous_damping"], 0.0)
        for curve in CURVES:
            (a, b), rho = curve["standard_errors"], curve["correlation"]
            first, second = random.multivariate_normal([0, 0], [[a * a, rho * a * b], [rho * a * b, b * b]])
            names = ("slope", "intercept") if curve["quantity"] == "no_load" else ("quadratic", "linear")
            for part, change in zip(names, (first, second), strict=True):
                key = f"{curve['quantity']}_{part}_forward"
                draw[key] = sets.best[key] + change
        draws.append(draw)
    row = next(row for row in numbers_for(sets, "gazebo").rows if row.name == name)
    # A standard deviation of 300 draws is known to 4 %; the mean drag is not linear in them.
    assert np.ptp(row.ends) / 2 == pytest.approx(spread(number, draws), rel=0.15)
    assert row.ends[0] < row.value < row.ends[1]


def test_what_nobody_assessed_has_no_interval_and_what_nobody_measured_no_number():
    ends = {row.name: row.ends for row in numbers_for(assessed({}), "gazebo").rows}
    assert ends["motorConstant"] is not None
    assert ends["timeConstantUp"] is ends["rollingMomentCoefficient"] is None
    sets = assessed()
    guess = "default of the model, not measured: guess for a propeller"
    records = [
        replace(r, status="fixed", source=guess) if r.name.startswith("thrust_") else r
        for r in sets.parameters
    ]
    numbers = numbers_for(replace(sets, parameters=records), "gazebo")
    assert {row.name for row in numbers.rows if row.why_not} == {"motorConstant", "momentConstant"}
    assert "thrust_quadratic_forward not measured" in numbers.missing[0]
    assert "<motorConstant>" not in numbers.text()
    assert "motorConstant cannot be given" in numbers.text()
    # A log without a command gives no speed at full command, and nothing that rests on it.
    lost = sets_of(no_load_slope_forward=math.nan, no_load_intercept_forward=math.nan)
    assert [row.name for row in numbers_for(lost, "crazyflow").rows if row.why_not] == [
        "rotor_dyn_coef[0]", "rotor_dyn_coef[2]", "thrust_max",
    ]  # fmt: skip
    with pytest.raises(
        ExportError, match="THR_MDL_FAC cannot be given: no_load_slope_forward, no_load_inter"
    ):
        numbers_for(sets_of(no_load_slope_forward=math.nan, no_load_intercept_forward=math.nan,
                            thrust_quadratic_forward=math.nan), "px4")  # fmt: skip


def test_loaded_speeds_that_were_measured_do_not_move_with_the_resistance():
    free, tied = assessed(), assessed(static_curves_of_best_set=[CURVES[2]])
    widths = [np.ptp(numbers_for(sets, "gazebo").rows[2].ends) for sets in (free, tied)]
    bare = assessed({}, static_curves_of_best_set=[CURVES[2]])
    only_line = replace(bare, parameters=[replace(r, status="fixed") for r in bare.parameters])
    # What is left of the tied speed's interval is the error of its line.
    assert widths[1] < 0.9 * widths[0]
    assert widths[1] == pytest.approx(np.ptp(numbers_for(only_line, "gazebo").rows[2].ends), rel=0.02)


def test_the_check_says_what_four_rotors_lift():
    force = float(
        thrust(table_1_speed := float(steady_state(1.0, motion_of(table_1())[0])[1]), motion_of(table_1())[0])
    )
    lift = 4 * force / 9.80665
    check = numbers_for(table_1(), "gazebo", mass=1.2).check
    assert check.startswith(f"at maxRotVelocity, {table_1_speed:.1f} rad/s, one rotor gives {force:.3f} N")
    share = 1.2 / lift
    assert (
        f"four lift {lift:.3f} kg at most and hover 1.2 kg at {100 * share**0.5:.0f} % of that speed" in check
    )
    assert f"{100 * share:.0f} % of that thrust" in check
    assert "do not lift 5 kg" in numbers_for(table_1(), "px4", mass=5.0).check


def test_a_motor_recorded_forward_alone_is_exported(tmp_path, run):
    sets = table_1()
    reverse = {name: math.nan for name in sets.names if name.endswith("_reverse")}
    source = export(sets_of(**reverse), tmp_path / "sets.json")
    code, _, err = run("export", source, "--out", tmp_path / "motor.sdf")
    assert code == 0, err
    text = (tmp_path / "motor.sdf").read_text(encoding="utf-8")
    assert "Reverse rotation" not in text
    assert "<motorConstant>1.2e-05</motorConstant>" in text
    # The comments of the model are those of the text.
    assert all(f"<!-- {row.comment} -->" in text for row in numbers_for(sets, "gazebo").rows)


def test_the_command_prints_what_it_writes(tmp_path, run):
    source = export(table_1(), tmp_path / "sets.json")
    for target in TARGETS:
        code, out, err = run("export", source, "--for", target, "--mass", "1.2 kg")
        assert (code, err) == (0, "")
        assert out == sysid.numbers_for(table_1(), target, mass=1.2).text()
        assert run("export", source, "--for", target, "--mass", "1200 g", "--out", tmp_path / target)[0] == 0
        assert (tmp_path / target).read_text(encoding="utf-8") == out
    code, out, _ = run("export", source, "--for", "gazebo", "--out", tmp_path / "motor.sdf", "--mass", "1.2")
    assert out == sysid.numbers_for(table_1(), "gazebo", mass=1.2).text()
    assert "hover 1.2 kg" in (tmp_path / "motor.sdf").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("kind", "arguments", "words"),
    [
        (
            "motor",
            ("--for", "gazeebo"),
            "unknown target 'gazeebo'; expected one of gazebo, rotorpy, crazyflow",
        ),
        ("gear", ("--for", "px4"), "px4 takes a motor's numbers; published-gear-lf has gear sets"),
        ("motor", (), "give --out FILE"),
        ("motor", ("--out", "a.json", "--mass", "1 kg"), "--mass goes with --for"),
        ("motor", ("--for", "px4", "--slope", "3 deg"), "leave them out"),
        ("motor", ("--for", "px4", "--out", "a.json"), "leave --for out to write the sets"),
        ("motor", ("--for", "px4", "--out", "a.sdf"), "such as .txt"),
        ("motor", ("--for", "px4", "--set", "2"), "no set of rank 2"),
        ("motor", ("--for", "px4", "--mass", "-1 kg"), "expected 0 kg or more"),
        ("motor", ("--for", "px4", "--mass", "1 m"), "--mass"),
        ("motor", ("--for", "px4", "--out", "sets.json/a.txt"), "sets.json"),
    ],
)
def test_refusals_print_one_sentence_and_write_nothing(kind, arguments, words, tmp_path, monkeypatch, run):
    source = export(table_1() if kind == "motor" else table_2("lf"), tmp_path / "sets.json")
    monkeypatch.chdir(tmp_path)
    code, out, err = run("export", source, *arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert words in err
    assert [path.name for path in tmp_path.iterdir()] == ["sets.json"]


def test_names_of_strangers_end_no_comment():
    sets = replace(table_1(), name="a --> <b/> ----- \n motorConstant")
    root = ElementTree.fromstring(f"<plugin>{numbers_for(sets, 'gazebo').text()}</plugin>")
    assert len(root) == len(TARGETS["gazebo"].numbers)
    assert tomllib.loads(numbers_for(sets, "crazyflow").text())["prop_inertia"] == 2.7e-5


# What a slow stand shows beside a model that does not explain it: a law over the command that is no
# line, and steps of the speed.
LEVELS = [[0.1, 0.0, 1.0], [0.3, 300.0, 0.99], [0.6, 480.0, 0.97], [0.9, 690.0, 0.9]]
TIMES = {
    "time_constant_up": {"value": 0.041, "interval_95": [0.039, 0.043], "steps": 18},
    "time_constant_down": {"value": 0.052, "interval_95": [0.047, 0.057], "steps": 2},
}


def stand(law="map", levels=LEVELS, verdict=NOT_BY, **times):
    # Over V/V_ref the levels say how the controller acts, not how fast the rotor turns.
    scaled = [[u, speed / ratio, 0.0] for u, speed, ratio in levels]
    forward = {"law": law, "levels": scaled, "measured": levels, "repeats": 0.01}
    settings = {"supply_law": {"forward": forward}, "stand": {"times": TIMES | times, "calibration": 0.01}}
    settings["command"] = {"minimum": 1000.0, "maximum": 2000.0, "unit": "us"}
    judged = {"verdict": verdict, "sentence": "judged", "nrmse": 0.1, "floor": 0.01, "ratio": 9.0}
    provenance = {"adequacy": judged | {"limits": {}, "channels": []}}
    return replace(assessed(**settings), provenance=provenance)


def test_steady_levels_that_are_no_line_are_the_law_of_the_command():
    sets = stand("map", dead_time={"value": 0.03, "interval_95": [0.02, 0.04], "steps": 20})
    rotor = FirstOrderRotor(dict(sets.best), np.array(LEVELS)[:, :2])
    np.testing.assert_allclose(rotor.speed(np.array([0.05, 0.3, 0.6, 0.9, 1.0])), [0, 300, 480, 690, 760])
    p = rotor.parameters | rotor.line_through(np.array([0.3, 0.6]), np.array([300.0, 480.0]))
    np.testing.assert_allclose(steady_state(np.array([0.3, 0.6]), p)[1], [300.0, 480.0], rtol=1e-9)
    rows = numbers_for(sets, "gazebo").to_frame()
    assert rows.value["maxRotVelocity"] == pytest.approx(760.0)
    # Speeds under one command differ by 1 %.
    ends = rows.loc["maxRotVelocity", ["interval_low", "interval_high"]].tolist()
    assert ends == pytest.approx([760.0 * (1 - 0.0196), 760.0 * (1 + 0.0196)])
    notes = numbers_for(sets, "gazebo").notes
    assert any("beyond the logs, which end at 90 % of it with 690 rad/s" in note for note in notes)
    volts = 0.9 * sets.best["reference_voltage"]
    assert any(f"sags with the load: it has {volts:.4g} V at 90 %" in note for note in notes)
    # It stands at 10 % of the command.
    assert numbers_for(sets, "px4").rows[0].value == pytest.approx(_expo(rotor, 0.1, 1.0), abs=1e-3)
    line = numbers_for(stand("line", dead_time=TIMES["time_constant_up"]), "gazebo").to_frame()
    assert line.value["maxRotVelocity"] == pytest.approx(749.8, abs=0.1)


def _expo(rotor, low, high):
    x = np.linspace(0, 1, 201)
    force = thrust(rotor.speed(low + (high - low) * x), rotor.parameters)
    share = (force - force[0]) / (force[-1] - force[0])
    return min(np.linspace(-1, 1, 2001), key=lambda f: float(np.sum((f * x**2 + (1 - f) * x - share) ** 2)))


def test_a_supply_that_limits_ends_the_curve_over_the_command():
    limited = [*LEVELS, [0.95, 690.0, 0.85]]
    sets = stand("map", limited, dead_time={"value": 0.03, "interval_95": [0.02, 0.04], "steps": 20})
    rotor = FirstOrderRotor(dict(sets.best), np.array(limited)[:, :2])
    numbers = numbers_for(sets, "ardupilot")
    rows = {row.name: row.value for row in numbers.rows}
    assert (rows["MOT_SPIN_MIN"], rows["MOT_SPIN_MAX"]) == (0.15, 0.9)
    assert rows["MOT_THST_EXPO"] == pytest.approx(_expo(rotor, 0.15, 0.9), abs=1e-3)
    # Over the whole range the thrust seems to bend the other way.
    assert _expo(rotor, 0.15, 0.95) < rows["MOT_THST_EXPO"]
    # Without sag a command gives more at the top.
    levels = np.array(LEVELS)
    stiff = FirstOrderRotor(dict(sets.best), np.column_stack([levels[:, 0], levels[:, 1] / levels[:, 2]]))
    words = f"with a voltage that stays it would be about {_expo(stiff, 0.15, 0.95):.2g}."
    (note,) = (note for note in numbers.notes if "limits the speed above 90 %" in note)
    assert note.endswith(words)
    assert not any("limits the speed" in note for note in numbers_for(sets, "gazebo").notes)


def test_steps_of_the_log_are_the_time_constants_where_the_model_does_not_explain_it():
    rows = numbers_for(stand(), "gazebo").to_frame()
    assert rows.loc["timeConstantUp", ["value", "interval_low", "interval_high"]].tolist() == pytest.approx(
        [0.041, 0.039, 0.043]
    )
    assert "without the model" in rows.law["timeConstantDown"]
    crazyflow = numbers_for(stand(), "crazyflow").to_frame()
    assert crazyflow.value["rotor_dyn_coef[2]"] == pytest.approx(1 / 0.052)
    explained = numbers_for(stand(verdict="explained"), "gazebo").to_frame()
    assert explained.value["timeConstantUp"] != 0.041


def test_the_calibration_of_the_load_cells_is_inside_the_intervals():
    def half(target, name, **stand):
        sets = assessed(stand=stand)
        row = numbers_for(sets, target).to_frame().loc[name]
        return (row.interval_high - row.interval_low) / 2 / row.value

    for target, name, cells in (
        ("gazebo", "motorConstant", 1), ("gazebo", "momentConstant", 2), ("rotorpy", "k_m", 1),
        ("crazyflow", "rpm2thrust[2]", 1), ("crazyflow", "rpm2torque[2]", 1),
    ):  # fmt: skip
        exact, loose = half(target, name), half(target, name, calibration=0.02)
        # Thrust and torque are of two cells.
        assert math.sqrt(loose**2 - exact**2) == pytest.approx(1.96 * 0.02 * math.sqrt(cells), rel=0.01)


def test_a_log_without_a_command_has_no_curve_over_it():
    (sentence,) = numbers_for(stand(), "px4").missing
    assert sentence == "THR_MDL_FAC cannot be given: no log has a command; record it beside the speed"
    gazebo = numbers_for(stand(), "gazebo")
    assert [row.why_not for row in gazebo.rows] == [""] * 7
    # Full command is nothing that these logs show, and the controller's defaults rest on none.
    assert "fastest steady speed of the logs" in gazebo.rows[2].law
    assert sum("No log has a command" in note for note in gazebo.notes) == 1
    assert not any("Full command is" in note for note in gazebo.notes)
    expo, low, high = numbers_for(stand(), "ardupilot").rows
    assert expo.why_not
    assert (low.value, high.value) == (0.15, 0.95)
    assert "no log" not in low.why_not + high.why_not
