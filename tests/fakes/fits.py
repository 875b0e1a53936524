"""Made-up fits: one with every part that a report shows, one with all that a fit folder stores."""

from dataclasses import replace

import numpy as np

from fakes.sets import made_sets
from sysid.fit.history import RunHistory, StageHistory
from sysid.fit.result import FitResult, TrialResult, ranked_sets
from sysid.parameter_sets import parameter_records
from sysid.parameters import Parameter, ParameterTable, SearchSpace

GEAR = (("x_B", "m"), ("z_B", "m"), ("x_B_rate", "m/s"), ("z_B_rate", "m/s"), ("q_B", "rad"))
MOTOR = (("stator_torque", "N·m"), ("speed", "rad/s"))


def made_fit(channels=GEAR, samples=150, lost=slice(40, 44), runs=5, uses=("fit", "fit", "validate"), seed=5):
    rng = np.random.default_rng(seed)
    table = ParameterTable(
        [Parameter("leg_axial_stiffness", "k_h", "N/m", 6440.0, 2e3, 12e3, "log", "Stiffness.", "Table II")]
    )
    space = SearchSpace.build(table, ["leg_axial_stiffness"], {})
    histories = tuple(
        RunHistory(
            i,
            (
                StageHistory(
                    algorithm="ga",
                    cube=rng.random((6 + i, 8, 1)),
                    cost=0.1 + np.sort(rng.random((6 + i, 8)), axis=1) * np.linspace(1, 0.01, 6 + i)[:, None],
                    failed=np.zeros(6 + i, dtype=np.int64),
                    evaluations=48,
                    simulations=144,
                    wall_time=1.0,
                    stop_reason="converged",
                ),
            ),
        )
        for i in range(runs)
    )
    ranked = ranked_sets(histories, space)
    time = 1.7e9 + np.arange(samples) / 200  # a clock of Unix seconds
    trials = []
    for number, use in enumerate(uses, start=1):
        measured = np.cumsum(rng.standard_normal((samples, len(channels))), axis=0)
        valid = np.ones(measured.shape, dtype=bool)
        valid[lost] = False
        simulated = measured + 0.3 * rng.standard_normal((runs, *measured.shape))
        trials.append(
            TrialResult(
                f"drop-{number}", use, time, measured, valid, simulated,
                0.01 * number + rng.random((runs, len(channels))),
            )
        )  # fmt: skip
    return FitResult(
        kind="gear" if channels is GEAR else "motor",
        name="bench",
        state="done",
        parameters=parameter_records(space),
        runs=histories,
        set_runs=ranked.run,
        set_seeds=ranked.seed,
        cube=ranked.cube,
        values=ranked.values,
        at_bound=ranked.at_bound,
        nrmse=ranked.cost,
        trials=tuple(trials),
        channels=tuple(name for name, _ in channels),
        channel_units=tuple(unit for _, unit in channels),
        channel_weights=(1.0,) * len(channels),
        settings={},
        provenance={"search": {"axes": ["leg_axial_stiffness"]}},
    )


def full_fit(seed=0, state="done"):
    """A fit with parameters of every status, runs of two stages, failures, and a warning."""
    fit = made_fit(MOTOR, samples=50, runs=3, seed=seed)
    sets = made_sets()
    runs = []
    for run in fit.runs:
        (stage,) = run.stages
        causes = tuple({"diverged": g, "left_the_board": 2} if g else {} for g in range(len(stage.cost)))
        stage = replace(stage, failed=np.arange(len(stage.cost)), causes=causes)
        finish = replace(stage, algorithm="cmaes", cube=stage.cube / 2, cost=stage.cost / 2)
        runs.append(replace(run, stages=(stage, finish)))
    return replace(
        fit,
        state=state,
        parameters=sets.parameters,
        runs=tuple(runs),
        values=np.column_stack([fit.values, sets.values[:, 1:]]),
        at_bound=np.column_stack([fit.at_bound, np.zeros((3, 3), np.int8)]),
        channel_weights=(1.0, 3.0),
        settings={"command": {"unit": "us", "minimum": 1000, "neutral": None, "maximum": 2000.0}},
        provenance={
            "logs": {"drop-1": {"sha256": "ab" * 32}},
            "filter": {"taps": (1, 2.5)},
            "nrmse_denominator": "std",
        },
        warnings=sets.warnings,
    )
