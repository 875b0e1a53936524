"""What roll and yaw cost a planar model: campaigns of drops of the exported four-legged model in space.

    python tests/benchmarks/spatial_drops.py [--first-seed 2] [--campaigns 1] [--own-plane]
    python tests/benchmarks/spatial_drops.py --table sysid/gear/out_of_plane.csv
    python tests/benchmarks/spatial_drops.py --other-gears 60

The first way fits three campaigns a seed, LF with half the noise of the samples (0.15 mm, 0.1 deg): released
straight, with a roll of 0.6 and a yaw of 2 deg (one sigma), and with 2 and 6 deg. `--own-plane` sees every
drop in the vertical plane of its own heading, on the slope that is there: atan(tan(slope) cos(yaw)).
`--table` writes what a lean costs, which `sysid.gear.out_of_plane` reads. `--other-gears` compares the table
with drawn drops of drawn gears of other sizes, released with a drawn roll and yaw.

Measured with seed 2 (one run of the default search a campaign):

| released with | NRMSE, noise | dz_j | k_h | k_t | k_s | drops that lean too much | found |
|---|---|---:|---:|---:|---:|---:|---:|
| nothing | 5.29, 3.54 % | +16 % | +1 % | -2 % | +37 % | 0 | 0 |
| 0.6 and 2 deg | 9.87, 3.59 % | +30 % | +5 % | -4 % | +264 % | 5 of 7 | these 5 |
| 2 and 6 deg | 18.1, 3.87 % | +135 % | -4 % | -25 % | +261 % | 7 of 7 | these 7 |

Leans are measured within 0.12 deg, although the axes of the rigid body hide what all drops share: 0.3 to 0.7
deg of these leans in the second campaign, 0.9 to 2.1 deg in the third. The NRMSE of a drop is what its lean
costs by the table beside its noise, within 2.3 % in ten of these 14 drops. Of 40 drawn drops of other gears,
0.6 to 1.6 times the size, half cost 0.96 to 2.0 times what the table says if the gear is smaller, 0.45 to 1.2
times if it is larger.

The plane of a drop's own heading does not help: 10.3 instead of 9.87 %, 18.3 instead of 18.1 %. At 15 deg a
roll of 1 and a yaw of 4 deg nearly cancel in the lean and cost 1.2 to 2.1 %, of which 0.4 to 1.6 % go with
the plane; a yaw of 4 deg alone costs 18 and 19 %, of which 2.4 and 0.2 % do.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from fakes.spatial_gear import drop_in_space, lowest_foot, simulator
from paired import flags, mean_nrmse
from sysid.campaign import read_campaign
from sysid.filters import KaiserLowpass, differentiate
from sysid.fit.search import run_one
from sysid.fit.settings import SearchSettings
from sysid.fit.trial import noise_floor
from sysid.gear import model
from sysid.gear.drops import as_compared
from sysid.gear.out_of_plane import cost_of_lean, leans, misfit_that_leans
from sysid.journal import Journal
from sysid.synthetic import read_truth, synthesize_gear
from sysid.synthetic.gear import LF_DROPS
from sysid.workflows.kinds import find_kind

# One sigma of roll and yaw at the release [deg].
CAMPAIGNS = {"straight": (0.0, 0.0), "0.6 and 2 deg": (0.6, 2.0), "2 and 6 deg": (2.0, 6.0)}
NOISE = {"noise_position": 0.15e-3, "noise_angle": math.radians(0.1)}
# Not the first one: on 5 deg MuJoCo's friction creeps unlike the kernel's, which bends k_h by 17 %.
DROPS = [replace(plan, use="fit") for plan in LF_DROPS[1:]]
# Slopes and leans [deg] and touchdown speeds [m/s] of the table.
SLOPES = {"lf": (5, 10, 15, 20, 25, 30, 35), "hf": (5, 10, 15, 20, 25)}
LEANS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
SPEEDS = {"lf": (0.4, 0.5, 0.6, 0.7, 0.8), "hf": (0.4, 0.5, 0.6)}
RATE, LOWPASS = 200.0, KaiserLowpass(200.0, 65.0, 60.0, 10.0)
_HEADER = """\
# What a lean of the feet across the surface costs a planar model: NRMSE of the five compared channels over
# 0.75 s, filtered like a log, between a drop that leans and one released straight, without noise. Median over
# touchdown speeds of {lf} m/s (lf) and {hf} m/s (hf).
# Written by tests/benchmarks/spatial_drops.py --table from drops of the paper's gear (Table II) in MuJoCo
# {version}, as exported with four single legs (export --per-leg); leans by roll alone.
law,slope [deg],lean [deg],nrmse [%]
"""


def compared(true, law, slope, speed, roll=0.0, yaw=0.0):
    """Signals (n, 5) of a drop from 50 ms before a straight one touches; None where a foot cannot fall."""
    fall, margin = speed / true["gravity"], LOWPASS.edge_samples + 1
    start = np.zeros(6)
    start[1] = true["foot_dx"] * math.tan(slope) + true["foot_dz"] + speed**2 / (2 * true["gravity"])
    turn = Rotation.from_euler("ZX", [yaw, roll])
    if lowest_foot(true, slope, start, turn) < 0.0:
        return None
    before = margin + round(0.05 * RATE)
    clock = np.arange(-before, margin + round(0.7 * RATE)) / RATE + fall
    falling = clock > 0.0
    place, turns = drop_in_space(
        true, slope, start, np.concatenate([[0.0], clock[falling]]), turn, sticks=law == "hf"
    )
    which = np.cumsum(falling)
    matrix = turns.as_matrix()[which]
    pitch = np.unwrap(np.arctan2(matrix[:, 0, 2], matrix[:, 2, 2]))
    smooth = LOWPASS.apply(np.column_stack([place[which][:, [0, 2]], pitch]))
    return as_compared(smooth, differentiate(smooth, RATE))[margin:-margin]


def table(path):
    """Write the table of `sysid.gear.out_of_plane`."""
    speeds = {law: ", ".join(map(str, values)) for law, values in SPEEDS.items()}
    text = _HEADER.format(version=mujoco.__version__, **speeds)
    for law, slopes in SLOPES.items():
        true = dict(model.parameters_on(law).nominal)
        for slope in map(math.radians, slopes):
            straight = {speed: compared(true, law, slope, speed) for speed in SPEEDS[law]}
            for lean in LEANS:
                roll = math.asin(math.sin(math.radians(lean)) / math.cos(slope))
                leaned = {speed: compared(true, law, slope, speed, roll) for speed in straight}
                costs = [mean_nrmse(b, straight[v]) for v, b in leaned.items() if b is not None]
                text += f"{law},{math.degrees(slope):.0f},{lean},{100 * np.median(costs):.2f}\n"
            print(text.splitlines()[-len(LEANS) :], flush=True)
    path.write_text(text, encoding="utf-8")


def other_gears(count):
    """Costs of drawn drops of drawn LF gears over those of the table."""
    source, ratios = np.random.default_rng(7), []
    for _ in range(count):
        rows = model.parameters_on("lf")
        true = dict(rows.nominal)
        for name in model.SURFACES["lf"].free:
            true[name] *= math.exp(0.2 * source.uniform(-1, 1))
        # A larger gear: lengths by a factor, masses and stiffnesses by its cube and square.
        size = math.exp(source.uniform(-0.5, 0.5))
        powers = {
            "foot_dx": 1, "foot_dz": 1, "joint_dx": 1, "joint_dz": 1, "body_mass": 3, "leg_mass": 3,
            "body_inertia": 5, "leg_inertia": 5, "leg_axial_stiffness": 2, "ground_stiffness": 2,
            "leg_bending_stiffness": 4, "leg_axial_damping": 2.5, "leg_bending_damping": 4.5,
        }  # fmt: skip
        true |= {name: true[name] * size**power for name, power in powers.items()}
        slope, speed = math.radians(source.uniform(5, 35)), source.uniform(0.45, 0.8)
        roll, yaw = np.radians([0.8, 2.5]) * source.standard_normal(2)
        lean = math.asin(math.sin(roll) * math.cos(slope) - math.sin(yaw) * math.sin(slope))
        drop = compared(true, "lf", slope, speed, roll, yaw)
        if drop is not None:
            cost = mean_nrmse(drop, compared(true, "lf", slope, speed))
            expected = cost_of_lean("lf", slope, lean)
            ratios.append((size, cost, expected))
            print(
                f"size {size:.2f}, {math.degrees(slope):4.1f} deg, {speed:.2f} m/s, lean "
                f"{math.degrees(lean):5.2f} deg: {100 * cost:5.1f} %, table {100 * expected:5.1f} %",
                flush=True,
            )
    ratios = np.array(ratios)
    for name, part in (("small", ratios[:, 0] < 1), ("large", ratios[:, 0] >= 1)):
        over = ratios[part, 1] / ratios[part, 2]
        print(name, "gears, cost over table, quantiles 10 25 50 75 90 %:", end=" ")
        print(*np.quantile(over, [0.1, 0.25, 0.5, 0.75, 0.9]).round(2))


def in_own_plane(simulate, attitudes, slopes):
    """A simulator whose drops are seen in the vertical plane of their own heading, about the hinge."""

    def seen(true, slope, start, clock, **law):
        run = simulate(true, slope, start, clock, **law)
        y, turns = run.pose
        yaw = attitudes[-1][1]
        slopes.append((slope, math.atan(math.tan(slope) * math.cos(yaw))))
        back = Rotation.from_euler("Z", -yaw)
        place = back.apply(np.column_stack([run.state[:, 0], y, run.state[:, 1]]))
        # The surface is higher or lower beside the hinge.
        place[:, 2] -= place[0, 1] * math.tan(slope) * math.sin(yaw)
        run.pose = place[:, 1], back * turns
        matrix = run.pose[1].as_matrix()
        pitch = np.unwrap(np.arctan2(matrix[:, 0, 2], matrix[:, 2, 2]))
        run.state = np.column_stack([place[:, 0], place[:, 2], pitch])
        return run

    return seen


def fitted(folder, name, seed, own_plane=False):
    """Fit one campaign and print what it gives."""
    attitudes, slopes = [], []
    simulate = simulator(seed, *np.radians(CAMPAIGNS[name]), attitudes)
    if own_plane:
        simulate = in_own_plane(simulate, attitudes, slopes)
    path = synthesize_gear(folder / f"{seed} {name}", seed=1, drops=DROPS, simulate=simulate, **NOISE)
    path = path / "campaign.toml"
    text = path.read_text(encoding="utf-8")
    for slope, own in slopes:
        text = text.replace(f'"{math.degrees(slope):.10g} deg"', f'"{math.degrees(own):.10g} deg"')
    path.write_text(text, encoding="utf-8")
    with Journal() as journal:
        problem = find_kind("gear").open(read_campaign(path, "gear"), path, None)
        accused = [finding for finding in journal.findings if finding.code == "released-out-of-plane"]
    run = run_one(problem, SearchSettings(runs=1, seed=seed))
    row = problem.space.full(run.best_point[None])[0]
    true = read_truth(path.parent)["parameters"]
    values = dict(zip(problem.space.table, row, strict=True))
    off = {p.symbol: f"{100 * (values[p.name] / true[p.name] - 1):+.0f} %" for p in problem.space.free}
    scores, found = problem.score(row[None]).by_channel[0].mean(axis=1), leans(problem)
    print(
        f"seed {seed}, {name}{', own plane' if own_plane else ''}: NRMSE {100 * scores.mean():.2f} %", end=""
    )
    print(f", noise {100 * noise_floor(problem.blocks):.2f} %;", *(f"{k} {v}" for k, v in off.items()))
    for drop, score, (roll, yaw) in zip(problem.drops, scores, attitudes, strict=True):
        lean = found[drop.name]
        print(
            f"  {drop.name}, {math.degrees(drop.slope):.0f} deg: roll {math.degrees(roll):+.2f}, yaw "
            f"{math.degrees(yaw):+.2f} deg, measured {math.degrees(lean.roll):+.2f}, "
            f"{math.degrees(lean.yaw):+.2f}; lean {math.degrees(lean.lean):+.2f} deg costs "
            f"{100 * lean.cost:.1f} %; NRMSE {100 * score:.1f} %{', release again' if lean.matters else ''}"
        )
    print("  accused:", "; ".join(map(str, accused)) or "none")
    print("  after the fit:", misfit_that_leans(problem, row), flush=True)


def main():
    """Measure and print."""
    parser = flags(__doc__, json=False, first_seed=2, campaigns=1, other_gears=0, own_plane=False)
    parser.add_argument("--table", type=Path)
    chosen = parser.parse_args()
    if chosen.table:
        return table(chosen.table)
    if chosen.other_gears:
        return other_gears(chosen.other_gears)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.first_seed, chosen.first_seed + chosen.campaigns):
            for name in CAMPAIGNS:
                fitted(Path(folder), name, seed, chosen.own_plane)
    return None


if __name__ == "__main__":
    main()
