"""Laws that the motor obeys whatever its parameters: equilibria, time constants, scale freedom, limits."""

import numpy as np
import pytest

from sysid.errors import CampaignError, FitError, UnitError
from sysid.motor import model
from sysid.motor.batch import SimulatedTrial, SimulatedTrials, simulate_population
from sysid.motor.model import kv_to_si, pack, simulate, unpack

FREE_OF_DRAG = dict.fromkeys(("torque_quadratic_forward", "torque_quadratic_reverse", "viscous_damping"), 0.0)
# Of the nominal motor.
K, RESISTANCE, INDUCTANCE, INERTIA = kv_to_si(960.0), 0.299, 0.0038, 2.7e-5
COLUMN = model.PARAMETERS.index


def _rows(count: int, seed: int = 7) -> np.ndarray:
    """Candidates drawn over the search bounds of R, L and k_d."""
    rng = np.random.default_rng(seed)
    rows = np.tile(pack({}), (count, 1))
    for name in model.FREE_DEFAULT:
        row = model.PARAMETERS[name]
        rows[:, COLUMN[name]] = np.exp(rng.uniform(np.log(row.lower), np.log(row.upper), count))
    return rows


@pytest.mark.parametrize("command", [0.2, 0.62, 1.0, -0.3, -1.0])
def test_steady_state_is_an_equilibrium(command: float) -> None:
    current, speed = model.steady_state(command, {})
    volts = K * float(model.no_load_speed(command, {}))
    drag = float(model.aerodynamic_torque(speed, {})) + 9.2e-9 * speed
    # Closed form: only rounding is left.
    assert volts - K * speed == pytest.approx(RESISTANCE * current, rel=1e-12)
    assert K * current == pytest.approx(drag, rel=1e-12)
    run = simulate({}, [0.0], [command], [0.0, 1.0], initial="steady")
    # Local error 1e-6 over one second at an equilibrium.
    np.testing.assert_allclose(run.speed, speed, rtol=1e-8)


def test_hover_speed_of_the_design_note() -> None:
    # 512 rad/s loaded belongs to 642 rad/s without load; both printed with three digits.
    _, speed = model.steady_state(642.0 / 1030.0, {"back_emf_constant": 0.00995, "torque_constant": 0.00995})
    assert float(speed) == pytest.approx(512.0, abs=1.0)


def test_mechanical_time_constant_without_inductance_and_drag() -> None:
    parameters = {**FREE_OF_DRAG, "winding_inductance": 1e-9}
    tau = INERTIA * RESISTANCE / K**2
    assert tau == pytest.approx(0.082, abs=0.0005)  # printed: 82 ms
    time = np.linspace(0.0, 0.4, 401)
    run = simulate(parameters, [0.0], [0.5], time, ideal_reversal=True)
    expected = 515.0 * (1.0 - np.exp(-time / tau))
    # L/R is 3e-9 s: the exponential is exact up to the local error of 1e-6.
    np.testing.assert_allclose(run.speed, expected, atol=515.0 * 5e-6)


def test_current_of_a_locked_rotor_rises_with_l_over_r() -> None:
    parameters = {**FREE_OF_DRAG, "rotor_inertia": 1e3}
    time = np.linspace(0.0, 0.1, 201)
    run = simulate(parameters, [0.0], [1.0], time, ideal_reversal=True)
    locked = K * 1030.0 / RESISTANCE
    expected = locked * (1.0 - np.exp(-time * RESISTANCE / INDUCTANCE))
    # The rotor of 1e3 kg·m² stays put to 1e-8; the rest is the local error.
    np.testing.assert_allclose(run.current, expected, atol=locked * 5e-6)


def test_linear_motor_follows_its_eigenvalues() -> None:
    parameters = {**FREE_OF_DRAG, "viscous_damping": 2e-5}
    matrix = np.array([[-RESISTANCE / INDUCTANCE, -K / INDUCTANCE], [K / INERTIA, -2e-5 / INERTIA]])
    rest = -np.linalg.solve(matrix, [K * 800.0 / INDUCTANCE, 0.0])
    values, vectors = np.linalg.eig(matrix.astype(complex))
    weights = np.linalg.solve(vectors, -rest.astype(complex))
    time = np.linspace(0.0, 0.5, 101)
    expected = (vectors @ (weights[:, None] * np.exp(values[:, None] * time))).real + rest[:, None]
    run = simulate(parameters, [0.0], [800.0 / 1030.0], time, ideal_reversal=True)
    # Local error 1e-6 of the scale, summed over some hundred steps.
    np.testing.assert_allclose(run.current, expected[0], atol=5e-6 * np.max(expected[0]))
    np.testing.assert_allclose(run.speed, expected[1], atol=5e-6 * np.max(expected[1]))


@pytest.mark.parametrize("factor", [0.3, 4.0])
def test_scale_freedom_leaves_torque_and_speed(factor: float) -> None:
    base = dict(model.PARAMETERS.nominal)
    scaled = dict(base)
    for power, names in ((1, ("back_emf_constant", "torque_constant")), (-1, ("saturation_current",)),
                         (2, ("winding_resistance", "winding_inductance"))):  # fmt: skip
        scaled |= {name: factor**power * base[name] for name in names}
    schedule, time = ([0.0, 0.4, 1.0], [0.7, -0.9, 0.5]), np.linspace(0.0, 1.5, 1501)
    plain, other = simulate(base, *schedule, time), simulate(scaled, *schedule, time)
    # The same arithmetic in other units: rounding, amplified once by each of the event times.
    np.testing.assert_allclose(other.speed, plain.speed, atol=1e-6)
    np.testing.assert_allclose(other.stator_torque, plain.stator_torque, atol=1e-9)
    np.testing.assert_allclose(other.current * factor, plain.current, atol=1e-6)
    for name, value in model.invariants(base).items():
        assert model.invariants(scaled)[name] == pytest.approx(value, rel=1e-12)


def test_stiff_winding_equals_the_quasi_steady_current() -> None:
    # L/R = 1e-6 s: the current is (V - k_v Ω)/R everywhere but within microseconds of a command.
    parameters = {"winding_inductance": 0.299e-6}
    time = np.arange(0.0, 1.0, 1e-3) + 0.5e-3
    run = simulate(parameters, [0.0, 0.5], [0.4, 0.9], np.concatenate([[0.0], time]), ideal_reversal=True)
    # Riccati equation of the quasi-steady motor, stepped by RK4 with 1000 times smaller error.
    omega, expected, h = 0.0, [], 1e-5
    for step in range(100_000):
        target = 1030.0 * (0.4 if step < 50_000 else 0.9)

        def rate(w: float, target: float = target) -> float:
            return (K * K * (target - w) / RESISTANCE - 1.65e-7 * w * w - 9.2e-9 * w) / INERTIA

        if step % 100 == 50:
            expected.append(omega)
        a = rate(omega)
        b = rate(omega + 0.5 * h * a)
        c = rate(omega + 0.5 * h * b)
        d = rate(omega + h * c)
        omega += h * (a + 2 * b + 2 * c + d) / 6
    # The winding delays the rotor by about L/R: 1e-6 s of at most 12 000 rad/s².
    np.testing.assert_allclose(run.speed[1:], expected, atol=0.03)


def test_energy_balance_through_a_reversal() -> None:
    # Electrical input = copper loss + drag + change of stored energy; ideal, so that I_eff = I.
    time = np.linspace(0.0, 1.0, 200_001)
    m = simulate({}, [0.0, 0.3], [0.8, -0.8], time, ideal_reversal=True)
    volts = K * np.where(time < 0.3, 0.8, -0.8) * 1030.0
    drag = m.stator_torque - K * m.current + model.aerodynamic_torque(m.speed, {}) + 2 * 9.2e-9 * m.speed
    power = volts * m.current - RESISTANCE * m.current**2 - drag * m.speed
    stored = 0.5 * INDUCTANCE * m.current**2 + 0.5 * INERTIA * m.speed**2
    # Trapezoids of 5 µs over a jump of the voltage at the grid point: half an interval of 800 W.
    balance = np.trapezoid(power, time) - (stored[-1] - stored[0])
    assert abs(balance) < 800.0 * 5e-6


def test_saturation_holds_only_in_the_dead_band_while_speeding_up() -> None:
    time = np.linspace(0.0, 1.0, 20_001)
    m = simulate({}, [0.0, 0.4], [0.6, -1.0], time, initial="steady")
    clipped = m.effective_current != m.current
    assert clipped.any()
    assert np.all(np.abs(m.speed[clipped]) <= 6.3 * (1 + 1e-9))
    np.testing.assert_allclose(np.abs(m.effective_current[clipped]), 0.35, rtol=1e-12)
    # Braking from above the band is never clipped: all clipped samples turn in reverse.
    assert np.all(m.speed[clipped] <= 0.0)
    # Time in the band from zero: about I^r Ω_min/(k_m I_sat) = 49 ms, drag aside (0.3 % of the torque).
    assert clipped.sum() * (time[1] - time[0]) == pytest.approx(0.0489, rel=0.01)


def test_direction_of_the_curves() -> None:
    # Mirror the command: a motor whose reverse curves equal the forward ones runs backwards exactly.
    even = {"torque_quadratic_reverse": 1.65e-7, "thrust_quadratic_reverse": 1.2e-5}
    time = np.linspace(0.0, 1.0, 501)
    plain = simulate(even, [0.0, 0.5], [0.7, -0.4], time)
    mirrored = simulate(even, [0.0, 0.5], [-0.7, 0.4], time)
    np.testing.assert_array_equal(plain.speed, -mirrored.speed)
    np.testing.assert_array_equal(plain.stator_torque, -mirrored.stator_torque)


def test_supply_that_sags_lowers_the_speed() -> None:
    time = np.linspace(0.0, 2.0, 201)
    knots = np.linspace(0.0, 2.0, 21)
    volts = np.linspace(11.1, 10.0, 21)
    run = simulate({}, [0.0], [0.8], time, initial="steady", voltage=(knots, volts))
    _, expected = model.steady_state(0.8, {}, voltage=10.0)
    # The sag of 0.55 V/s is slow beside the rotor's 50 ms under load: it trails by 2 rad/s.
    assert run.speed[-1] == pytest.approx(float(expected), abs=3.0)
    constant = simulate({}, [0.0], [0.8], time, initial="steady", voltage=([0.0, 5.0], [11.1, 11.1]))
    reference = simulate({}, [0.0], [0.8], time, initial="steady")
    np.testing.assert_allclose(constant.speed, reference.speed, rtol=1e-9)  # rounding of the ratio


def test_command_delay_shifts_the_response() -> None:
    time = np.linspace(0.0, 1.0, 1001)
    early = simulate({}, [0.0, 0.45], [0.3, 0.8], time, initial="steady")
    late = simulate({"command_delay": 0.05}, [0.0, 0.4], [0.3, 0.8], time, initial="steady")
    np.testing.assert_allclose(late.speed, early.speed, rtol=1e-12)  # the same instants but for rounding


def test_population_equals_single_simulations() -> None:
    rows = _rows(5)
    grid = np.linspace(0.0, 1.0, 501)
    fine = np.linspace(0.0, 1.0, 50_001)
    trials = SimulatedTrials(
        [
            SimulatedTrial(np.array([0.0, 0.4]), np.array([0.3, 0.8]), grid),
            SimulatedTrial(np.array([0.0, 0.5]), np.array([0.6, -0.8]), grid[::2], initial=(0.0, 0.0)),
        ]
    )
    run = simulate_population(rows, trials)
    assert np.all(run.status == 0)
    for i, row in enumerate(rows):
        for j, trial in enumerate(trials.trials):
            part = run.outputs[i, trials.first[j] : trials.first[j + 1]]
            commands = (trial.command_time, trial.command)
            alone = simulate(unpack(row), *commands, trial.time, initial=trial.initial)
            # One tolerance, one kernel; only the output times differ.
            np.testing.assert_array_equal(part[:, 1], alone.speed)
            dense = simulate(unpack(row), *commands, fine, initial=trial.initial)
            edges = np.searchsorted(fine, 0.5 * (trial.time[1:] + trial.time[:-1]))
            k = row[COLUMN["torque_constant"]]
            for m in range(50, len(edges), 97):
                cell = slice(edges[m - 1], edges[m] + 1)
                mean = np.trapezoid(k * dense.effective_current[cell], fine[cell]) / np.ptp(fine[cell])
                # Trapezoids of 20 µs in a cell of 2 or 4 ms, across jumps of up to 0.4 N·m.
                assert part[m, 0] == pytest.approx(mean, abs=0.4 * 0.02 / 2.0)


def test_delays_per_trial_add_to_the_parameter() -> None:
    grid = np.linspace(0.0, 0.6, 301)
    trial = SimulatedTrial(np.array([0.0, 0.2]), np.array([0.5, 0.9]), grid)
    both = simulate_population(
        pack({"command_delay": 0.02})[None], SimulatedTrials([trial, trial]), delays=np.array([[0.0, 0.03]])
    )
    second = simulate_population(pack({"command_delay": 0.05})[None], SimulatedTrials([trial]))
    np.testing.assert_allclose(both.outputs[0, 301:], second.outputs[0], atol=1e-9)  # rounding of 0.02 + 0.03


def test_hopeless_candidate_has_a_status_and_harms_no_other() -> None:
    grid = np.linspace(0.0, 0.6, 301)
    trials = SimulatedTrials([SimulatedTrial(np.array([0.0]), np.array([0.5]), grid)])
    rows = np.tile(pack({}), (3, 1))
    for name in model.PARAMETERS.group("torque curve"):
        rows[1, COLUMN[name]] = -1.0  # drag that drives: no equilibrium
    run = simulate_population(rows, trials)
    assert run.status[1, 0] != 0
    assert run.reached[1, 0] < 1.0
    assert np.isnan(run.outputs[1, 1:]).all()  # the first sample is the given start
    np.testing.assert_array_equal(run.outputs[0], run.outputs[2])
    with pytest.raises(FitError, match="stopped at"):
        simulate(unpack(rows[1]), [0.0], [0.5], grid)


@pytest.mark.parametrize(("rating", "words"), [(960e3, "960"), (0.00995, "rpm/V")])
def test_a_kv_that_is_no_rating_is_refused(rating: float, words: str) -> None:
    with pytest.raises(UnitError, match=words):
        kv_to_si(rating)


@pytest.mark.parametrize(
    ("parameters", "instants", "commands", "error", "words"),
    [
        ({}, [0.0], [1500.0], FitError, "u = 1500"),
        ({"winding_resistence": 0.3}, [0.0], [0.5], CampaignError, "winding_resistance"),
        ({}, [0.5, 0.0], [0.5, 0.1], FitError, "order of time"),
    ],
)
def test_refusals_name_the_number(parameters, instants, commands, error, words) -> None:
    with pytest.raises(error, match=words):
        simulate(parameters, instants, commands, [0.0, 1.0])
