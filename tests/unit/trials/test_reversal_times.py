"""Timing of thrust reversals: by hand-made thrust, by simulation, through the command line."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from fakes import places
from sysid.campaign.motor import ChebyshevFilter
from sysid.errors import LogError
from sysid.loaders import load
from sysid.motor.dead_band import reversal_delays
from sysid.motor.model import PARAMETERS, simulate
from sysid.recording import Channel, Recording
from sysid.synthetic.motor import TRIALS, synthesize_motor
from sysid.trials.bench_log import CommandSteps, command_steps
from sysid.trials.reversal import find_reversals, repetitions
from sysid.workflows.options import ReversalOptions
from sysid.workflows.reversal import log_reversals

CAMPAIGN = SimpleNamespace(filter=ChebyshevFilter())
SAMPLES = places.SAMPLES / "motor"


def _schedule(delays, hold=1.0):
    """Thrust of 2 N forward; `delays` after each reverse command it walks in 0.1 s to -1 N."""
    time = np.arange(0.0, 2 * hold * len(delays) + hold, 1e-3)
    thrust, instants, levels = np.full(time.size, 2.0), [0.0], [0.5]
    for i, delay in enumerate(delays):
        start = (2 * i + 1) * hold
        instants += [start, start + hold]
        levels += [-0.5, 0.5]
        down = (time >= start) & (time < start + hold)
        thrust[down] = np.clip(2.0 - 30.0 * (time[down] - start - delay), -1.0, 2.0)
    return time, CommandSteps(np.array(instants), np.array(levels)), (time, thrust)


def _turned(step, **options):
    """A simulated motor's reversal from u 0.62 to -1 after 0.5 s: rows [s], command, thrust, speed."""
    time = np.arange(0.0, 1.5, step)
    given, options = options.pop("parameters", {}), {"initial": "steady", **options}
    run = simulate(given, [0.0, 0.5], [0.62, -1.0], time, **options)
    steps = CommandSteps(np.array([0.0, 0.5]), np.array([0.62, -1.0]))
    return time, steps, (time, run.thrust), (time, run.speed)


def test_times_of_a_made_thrust():
    time, steps, thrust = _schedule([0.2])
    (reversal,) = find_reversals(time, steps, thrust)
    # 30 N/s from 2 N, after 0.2 s; crossings lie between samples of 1 ms.
    assert reversal.zero_crossing == pytest.approx(0.2 + 2.0 / 30.0, abs=1e-6)
    assert reversal.to_level == pytest.approx(0.2 + 2.9 / 30.0, abs=1e-6)
    assert reversal.dead_band == pytest.approx(0.1 / 30.0, abs=1e-6)  # from +5 % to -5 % of 1 N
    assert reversal.final_thrust == pytest.approx(-1.0)
    (back,) = find_reversals(time, steps, thrust, sense="to-forward")
    assert (back.before, back.after) == (-0.5, 0.5)
    assert len(find_reversals(time, steps, thrust, sense="both")) == 2
    # A stall of the logger at the command takes the reversal out.
    assert find_reversals(time, steps, thrust, skip=[(0.99, 1.1)]) == ()


def test_a_controller_that_fails_half_of_the_time_has_outliers():
    # The paper's: 220 ms, but 750 ms over half of the time. The median is then a failure itself.
    (group,) = repetitions(find_reversals(*_schedule([0.12, 0.65, 0.65, 0.12, 0.65])))
    assert group.median("to_level") == pytest.approx(0.65 + 2.9 / 30, abs=1e-6)
    assert group.outliers() == 3
    # One that never gets there is no better, and is measured against the others' final thrust.
    (group,) = repetitions(find_reversals(*_schedule([0.1, 0.1, 2.0])))
    assert group.outliers() == 1
    assert np.isnan(group.reversals[2].to_level)
    assert group.reversals[2].final_thrust == pytest.approx(-1.0)
    # One that fails four times of five has its quick repetitions still.
    for count in (5, 20):
        delays = [0.12 if i % 5 == 3 else 0.65 for i in range(count)]
        (group,) = repetitions(find_reversals(*_schedule(delays)))
        assert group.outliers() == 4 * count // 5


def test_a_hold_too_short_to_settle_is_not_measured_against_itself():
    # 0.3 s: it walks from 2 N until 0.25 s, then on; at its end it has just got to -0.4 N.
    time, steps, (_, thrust) = _schedule([0.22, 0.22], hold=0.3)
    assert thrust.min() == pytest.approx(-0.37, abs=0.02)
    (group,) = repetitions(find_reversals(time, steps, (time, thrust)))
    assert group.unsettled
    assert group.outliers() == 2
    assert all(np.isnan([r.to_level, r.final_thrust, r.dead_band]).all() for r in group.reversals)
    # Where the thrust was zero is known all the same.
    assert group.median("zero_crossing") == pytest.approx(0.22 + 2 / 30, abs=1e-6)


def test_neutral_in_passing_and_jitter_hide_no_reversal():
    time, steps, thrust = _schedule([0.2, 0.2, 0.2])
    plain = find_reversals(time, steps, thrust)
    u = steps.level[np.searchsorted(steps.time, time, side="right") - 1]
    passing = u.copy()
    for start in steps.time[1:]:
        passing[(time >= start - 0.0205) & (time < start - 5e-4)] = 0.0  # 20 rows of 1 ms
    assert find_reversals(time, command_steps(time, passing), thrust) == plain
    # One microsecond of 500 either way, in every row.
    shaken = u + 0.002 * np.random.default_rng(1).integers(-1, 2, u.size)
    assert command_steps(time, shaken).time.size > 1000
    reversals = find_reversals(time, command_steps(time, shaken), thrust)
    (group,) = repetitions(reversals)
    assert len(group.reversals) == 3
    # Which of the three levels was held longest is chance; when is not.
    assert (group.before, group.after) == pytest.approx((0.5, -0.5), abs=0.0021)
    assert [r.to_level for r in reversals] == pytest.approx([r.to_level for r in plain], abs=1e-9)
    # A neutral of 0.1 s is a rest: what follows it is a start, and no reversal.
    rest = u.copy()
    for start in steps.time[1:]:
        rest[(time >= start - 0.1) & (time < start - 5e-4)] = 0.0
    assert find_reversals(time, command_steps(time, rest), thrust) == ()


def _sagging(failed=()):
    """Ten reversals of a motor on a battery that loses 10 % of its voltage; some leave rest 0.5 s late."""
    count, hold = 10, 1.0
    instants = np.arange(2 * count + 1) * hold
    levels = np.where(np.arange(2 * count + 1) % 2, -1.0, 0.62)
    time = np.arange(0.0, instants[-1] + hold, 1e-3)
    volts = 11.1 * (1.0 - 0.1 * time / time[-1])
    late = instants.copy()
    late[[2 * i + 1 for i in failed]] += 0.5
    run = simulate({}, late, levels, time, initial="steady", voltage=(time, volts))
    return time, CommandSteps(instants, levels), (time, run.thrust), (time, run.speed)


def test_a_battery_that_sags_makes_no_outliers():
    (group,) = repetitions(find_reversals(*_sagging()))
    assert group.outliers() == 0
    each = np.array([r.to_level for r in group.reversals])
    # A tenth less voltage: a tenth less torque to turn the rotor round, and a tenth less speed to reach.
    assert np.ptp(each) < 0.1 * each.min()
    # Thrust goes with the square of the speed, the speed a little slower than the voltage.
    finals = np.array([r.final_thrust for r in group.reversals])
    assert np.all(np.diff(finals) > 0)
    assert finals[-1] / finals[0] == pytest.approx(0.9**1.7, abs=0.04)
    # By thrust alone as well, where the dead band is read from the thrust.
    (alone,) = repetitions(find_reversals(*_sagging()[:3]))
    assert alone.outliers() == 0
    assert np.all([0 < r.dead_band < 0.15 for r in alone.reversals])


def test_outliers_on_a_battery_that_sags_are_found():
    # 0.2 s or, half of the time, 0.7 s.
    late = (1, 2, 5, 6, 9)
    (group,) = repetitions(find_reversals(*_sagging(late)))
    assert group.outliers() == len(late)
    assert [i for i, r in enumerate(group.reversals) if r.to_level > 0.5] == list(late)


def test_half_of_the_thrust_is_no_final_thrust():
    # A repetition that stays at -0.5 N of -1 N has not reversed; one that only begins to at the end neither.
    time, steps, (_, thrust) = _schedule([0.1, 0.1, 0.1])
    third = (time >= 5.0) & (time < 6.0)
    weak = np.where(third, np.maximum(thrust, -0.5), thrust)
    (group,) = repetitions(find_reversals(time, steps, (time, weak)))
    assert np.isnan(group.reversals[2].to_level)
    assert group.outliers() == 1
    creeping = np.where(third, np.where(thrust < 0, -(time - 5.0), thrust), thrust)
    (group,) = repetitions(find_reversals(time, steps, (time, creeping)))
    # Its own last quarter means -0.88 N, which it would pass at 0.79 s; it drifts, so -1 N counts.
    assert group.reversals[2].to_level == pytest.approx(0.9, abs=2e-3)
    assert group.outliers() == 1


def test_dead_band_of_a_simulated_motor():
    late = {"command_delay": 0.01}
    (real,) = find_reversals(*_turned(1e-4, parameters=late))
    (ideal,) = find_reversals(*_turned(1e-4, parameters=late, ideal_reversal=True))
    # I^r Ω_min/(k_m I_sat) = 49 ms from standstill to the band's edge; the rest is passed in 5 to 10 ms.
    assert 0.049 < real.dead_band < 0.060
    assert ideal.dead_band < 0.012
    # design note: 0.21 s to 90 % for u 0.62 → -1
    assert real.to_level - 0.01 == pytest.approx(0.21, abs=0.005)
    # Both brake alike, so the ideal motor is ahead by what the dead band costs.
    assert real.zero_crossing == pytest.approx(ideal.zero_crossing, abs=1e-3)
    assert 0.035 < real.to_level - ideal.to_level < 0.06


def test_noise_leaves_the_dead_band_as_long_as_it_is():
    time, steps, (_, thrust), _ = _turned(1e-3)
    (quiet,) = find_reversals(time, steps, (time, thrust))
    # 3 % of the final thrust: a first crossing of either edge comes by noise alone.
    noise = 0.03 * abs(quiet.final_thrust) * np.random.default_rng(3).standard_normal(time.size)
    (noisy,) = find_reversals(time, steps, (time, thrust + noise))
    assert noisy.dead_band == pytest.approx(quiet.dead_band, abs=0.02)
    assert noisy.to_level == pytest.approx(quiet.to_level, abs=0.02)


def test_thrust_alone_serves():
    time, steps, thrust, (_, speed) = _turned(1e-3)
    (by_thrust,) = find_reversals(time, steps, thrust)
    (unsigned,) = find_reversals(time, steps, thrust, (time, np.abs(speed)))
    assert unsigned == by_thrust
    # 5 % of the thrust is 22 % of the speed: a wider band.
    assert 0.06 < by_thrust.dead_band < 0.12


def _bench(levels, window, parameters, rate=1000.0, fast=False):
    """What `reversal_delays` sees of one reversal trial, a step every second, simulated with `parameters`."""
    time = np.arange(0.0, float(len(levels)), 1.0 / rate)
    steps = CommandSteps(np.arange(float(len(levels))), np.array(levels))
    thrust = simulate(parameters, steps.time, steps.level, time, initial="steady").thrust
    log = SimpleNamespace(
        time=time, interval=1.0 / rate, steps=steps, channels={"thrust": (time, thrust)}, fast=fast,
        window=window, doubtful=(), where="turns.h5",
    )  # fmt: skip
    entry = SimpleNamespace(name="turns", log="turns.h5", use="fit", direction="reversal")
    simulated = SimpleNamespace(time=time[time >= window[0]], supply=None)
    return SimpleNamespace(trials=(SimpleNamespace(log=log, entry=entry, simulated=simulated),))


def test_reversal_delays_are_those_of_the_window():
    best = {**PARAMETERS.nominal, "command_delay": 0.008}
    # A second at each; the window opens and closes in the middle of holds. Before
    # it lies a start in reverse, from which nothing inside it comes.
    levels = [-0.5, 0.62, -1.0, 0.4, -0.6]
    delays = reversal_delays(CAMPAIGN, _bench(levels, (1.4, 3.7), best), best)
    assert [(d["command_before"], d["command_after"]) for d in delays] == [(0.62, -1.0), (-1.0, 0.4)]
    for delay in delays:
        # The same motor twice, on grids of 1 and of 0.5 ms, starting at rest of the same command.
        assert delay["simulated"] == pytest.approx(delay["measured"], abs=2e-4)


def test_reversal_delays_pass_the_filter_of_the_campaign():
    best = {**PARAMETERS.nominal, "command_delay": 0.008}
    # 156 rows a second bear a stop band from 15 Hz on, not one from 100 Hz.
    slow = SimpleNamespace(filter=ChebyshevFilter(stop_edge="15 Hz"))
    delays = reversal_delays(slow, _bench([0.5, 0.62, -1.0, 0.4, -0.6], (1.4, 3.7), best, 156.0, True), best)
    for delay in delays:
        # A stop band from 15 Hz on rings for some 0.05 s.
        assert delay["simulated"] == pytest.approx(delay["measured"], abs=0.05)
    assert len(delays) == 2


def test_command_line_compares_logs(run, tmp_path):
    logs = [SAMPLES / "reversal-1.h5", SAMPLES / "reversal-2.h5"]
    figure = tmp_path / "reversal.png"
    code, out, err = run("reversal-time", *logs, "--figure", figure)
    assert code == 0, err
    assert "reversal-1.h5" in out
    assert "+0.62 → -1.00" in out
    assert figure.stat().st_size > 10_000
    code, out, _ = run("reversal-time", *logs, "--json", "--sense", "both")
    assert code == 0
    document = json.loads(out)
    first = document["logs"][0]["repetitions"][0]
    # 0.21 s of the motor, 8 ms of command delay; a thrust noise of 8 mN behind the filter is 1 ms at 90 %.
    assert first["to_level"]["median"] == pytest.approx(0.219, abs=0.003)
    assert first["outlier_share"] == 0
    assert len(document["logs"][1]["repetitions"]) == 5
    assert document["logs"][0]["crossing_from"] == "speed"


def test_logs_of_a_folder_that_do_not_reverse_are_named_and_left_out(run):
    code, out, err = run("reversal-time", SAMPLES)
    assert code == 0
    assert "reversal-2.h5  +0.30 → -0.62" in out
    assert re.search(r"left out: \S*forward-1\.csv: no reversal that can be timed", err)
    assert err.count("left out: ") == 7


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["forward-1.csv"], "no reversal that can be timed: commands run from u = 0 to 0.95"),
        (["reversal-1.h5", "--thrust-sign", "-1"], "leave out --thrust-sign -1"),
        (["reversal-1.h5", "--neutral", "900"], "minimum 1000, neutral 900, maximum 2000 us are not in"),
        (["reversal-1.h5", "--maximum", "1600"], "outside 1000 to 1600 us"),
        (["reversal-1.h5", "--thrust-sign", "5"], "--thrust-sign 5: it turns thrust and does not scale it"),
        (["reversal-1.h5", "--slow", "-1"], "--slow -1: how many times slower"),
        (["reversal-1.h5", "--slow", "nan"], "--slow nan: how many times slower"),
        (["static-forward.csv"], "has averaged points"),
        (["no-such.csv"], "no such log"),
    ],
)
def test_refusals_are_sentences(refused, tmp_path, arguments, words):
    figure = tmp_path / "none.png"
    refused(words, "reversal-time", SAMPLES / arguments[0], *arguments[1:], "--figure", figure)
    assert not figure.exists()


def _with(monkeypatch, recording, **channels):
    """Let the next log read be `recording` with other channels."""
    given = Recording(recording.kind, {**recording.channels, **channels}, recording.provenance)
    monkeypatch.setattr("sysid.workflows.reversal.load", lambda *_, **__: given)


def _part_of(channel, rows):
    return Channel(channel.name, channel.unit, channel.time[rows], channel.values[rows])


def _slower(channel):
    """A sensor of a tenth of the rate: each row the mean of ten, so that their noise is not folded down."""
    rows = channel.time.size // 10 * 10
    time, values = (a[:rows].reshape(-1, 10).mean(axis=1) for a in (channel.time, channel.values))
    return Channel(channel.name, channel.unit, time, values)


def test_synthesized_motor_without_a_dead_band(monkeypatch, tmp_path, run):
    monkeypatch.setattr(
        "sysid.synthetic.motor.synthesize_motor.__kwdefaults__",
        {**synthesize_motor.__kwdefaults__, "trials": TRIALS[-1:]},
    )
    code, _, err = run("synthesize", "motor", "--out", tmp_path / "m", "--ideal-reversal")
    assert code == 0, err
    (group,) = log_reversals(tmp_path / "m" / "reversal-2.h5").groups[:1]
    # 54 ms with a dead band; the filter of 100 Hz alone makes some of a sharp crossing.
    assert group.median("dead_band") < 0.015
    truth = json.loads((tmp_path / "m" / "truth.json").read_text(encoding="utf-8"))
    assert "ideal_reversal" in json.dumps(truth)


def test_channels_with_their_own_clocks(monkeypatch):
    path = SAMPLES / "reversal-2.h5"
    whole, log = log_reversals(path, ReversalOptions(sense="both")), load(path)
    # Any channel at a tenth of 10 kHz may cost a sample of it, 1 ms, and half of one of the mean of ten. At
    # 90 % a strong thrust rises by 3 to 7 N/s: 8 mN of noise, filtered otherwise, are 1 to 3 ms.
    for name in ("speed", "command", "thrust"):
        slow = _part_of(log[name], slice(None, None, 10)) if name == "command" else _slower(log[name])
        _with(monkeypatch, log, **{name: slow})
        moved = log_reversals(path, ReversalOptions(sense="both"))
        assert len(moved.groups) == len(whole.groups) == 5
        for group, reference in zip(moved.groups, whole.groups, strict=True):
            for key in ("zero_crossing", "dead_band"):
                assert group.median(key) == pytest.approx(reference.median(key), abs=2e-3), (name, key)
            if abs(reference.reversals[0].final_thrust) > 3.0:
                times = group.median("to_level"), reference.median("to_level")
                assert times[0] == pytest.approx(times[1], abs=3e-3), name
    # A thrust one row short.
    _with(monkeypatch, log, thrust=_part_of(log["thrust"], slice(0, -1)))
    (first, *_) = log_reversals(path, ReversalOptions(sense="both")).groups
    assert first.median("to_level") == pytest.approx(whole.groups[0].median("to_level"), abs=1e-6)


def test_tare_without_a_row_at_rest_and_notes_on_the_terminal(monkeypatch, run):
    path = SAMPLES / "reversal-1.h5"
    log = load(path)
    rest = log["thrust"].values[: round(0.4 / np.median(np.diff(log["thrust"].time)))]
    begun = log["speed"].time >= log["speed"].time[0] + 1.0
    cut = {name: _part_of(channel, begun) for name, channel in log.channels.items()}
    whole = log_reversals(path, ReversalOptions(sense="both"))
    _with(monkeypatch, log, **cut)
    late = log_reversals(path, ReversalOptions(sense="both"))
    offset = log["thrust"].values[begun].mean() - np.interp(cut["thrust"].time, *whole.thrust).mean()
    assert abs(offset) > 0.05  # this log has a tare to find
    finals = [[r.final_thrust for g in timed.groups for r in g.reversals] for timed in (late, whole)]
    # Six steady levels leave the zero to within a few mN; weak reversals end at 0.9 N.
    assert finals[0] == pytest.approx(finals[1], abs=0.02)
    assert offset == pytest.approx(rest.mean(), abs=5e-3)
    # An unsigned probe serves as well.
    cut["speed"] = Channel("speed", "rad/s", cut["speed"].time, np.abs(cut["speed"].values))
    _with(monkeypatch, log, **cut)
    alone = log_reversals(path, ReversalOptions(sense="both"))
    assert [r.final_thrust for g in alone.groups for r in g.reversals] == pytest.approx(finals[0], abs=1e-3)
    code, out, _ = run("reversal-time", path)
    assert code == 0
    assert "reversal-1.h5: no row at rest: the tare of thrust, " in out


def test_unitless_dshot_needs_a_neutral(tmp_path):
    rows = ["Time (s),ESC signal,Thrust (N),Motor Optical Speed (rad/s)"]
    for i in range(400):
        # A sensor that shakes: a value repeated exactly counts as held, not as measured.
        force = (1.0 if i < 200 else -1.0) + 1e-3 * (i % 3)
        rows.append(f"{0.01 * i:.2f},{1500 if i < 200 else 500},{force:.3f},100")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    with pytest.raises(LogError, match="commands are in dshot, whose neutral is not known"):
        log_reversals(path)
    timed = log_reversals(path, ReversalOptions(minimum=0, neutral=1024, maximum=2047))
    assert timed.groups[0].reversals[0].to_level == pytest.approx(0.0, abs=0.02)
    # The same numbers as bidirectional DShot: 1500 is 45 % of the high half, 500 45 % of the low one.
    halves = log_reversals(path, ReversalOptions(forward_half="high"))
    assert (halves.groups[0].before, halves.groups[0].after) == (0.453, -0.453)
    with pytest.raises(LogError, match="--forward-half says what every DShot number means"):
        log_reversals(path, ReversalOptions(neutral=1024, forward_half="high"))
