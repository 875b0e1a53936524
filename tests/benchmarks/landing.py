"""Landings per second: sysid's lanes against scipy's LSODA on the same right-hand side.

``python tests/benchmarks/landing.py``; ``--maps`` computes Fig. 8 (four maps, five sets), ``--impulse`` one
map of Fig. 9 (4.3 million combinations); ``--every 4`` takes every fourth slope and speed. Times are of
the wall and of the processor; the ratio is what counts on a machine that does other things as well.

Fig. 9 on two idle cores, with ``--no-check``: LF 114 s (142 s of processor, 1.38 million landings simulated),
HF 119 s (161 s, 1.67 million).
"""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

import gear_rivals
from fakes.published import table_1, table_2
from paired import flags, mean_nrmse, measured
from sysid.gear.model import PARAMETERS, Drops, Ending, prepare, simulate, simulate_population
from sysid.landing.controllers import find_controller
from sysid.landing.drone import Drone, Motors, drones
from sysid.landing.impulse import impulse_maps
from sysid.landing.maps import landing_maps
from sysid.landing.settings import LANDING_TOLERANCE, ImpulseSettings, MapSettings, Scenario, grid
from sysid.landing.simulate import land_many


def fleet(surface, sets=5):
    """Five sets around the published means: the paper prints mean and σ, not the sets."""
    (drone,) = drones(table_2(surface), table_1())
    sigma = {r.name: r.stated_sigma for r in table_2(surface).parameters if r.stated_sigma}
    rng = np.random.default_rng(1)
    out = []
    for rank in range(sets):
        values = dict(drone.gear)
        for name, s in sigma.items():
            row = PARAMETERS[name]
            values[name] = float(
                np.clip(values[name] + 0.5 * s * rng.standard_normal(), row.lower, row.upper)
            )
        out.append(Drone(values, drone.motor, surface, f"{surface} {rank + 1}"))
    return tuple(out)


# Bound within which LSODA must agree with the kernel until the second touchdown, or it solves another
# problem: mean NRMSE in the first 0.1 s.
SAME = 5e-3


def rivals(repeats):
    """One core, the same powered landings of Table II's means: how many a second, and the ratios.

    LSODA gets our compiled right-hand side with the same thrust and runs to the horizon of 3 s; sysid to the
    horizon, and as its maps do, until the drone is at rest or flipped.
    """
    cells = grid(np.radians([5.0, 15.0, 25.0, 35.0]), [0.3, 0.6, 0.9, 1.2])
    drone = Drone({}, table_1().set_values(), "lf")
    for controller in (find_controller("off"), find_controller("reverse")):
        thrust = Motors(drone).propulsion(controller.steps)
        starts = np.array([drone.start(c) for c in cells])
        slopes = np.array([c.slope for c in cells])
        many = Drops(
            np.tile(slopes, repeats),
            np.tile(starts, (repeats, 1)),
            [np.array([0.0, 3.0])] * (len(cells) * repeats),
            thrust,
        )
        print(f"\nLF, {controller.label}, one core:{'landings/s':>33} {'ms each':>9} {'ratio':>7}")
        spent = {}
        for ending, name in ((Ending(), "sysid to 3 s"), (Ending("rest"), "sysid to rest or flip")):
            _, cpu, _ = measured(
                lambda ending=ending, many=many: simulate_population(
                    drone.row, many, tolerance=LANDING_TOLERANCE, threads=1, ending=ending
                )
            )
            spent[name] = cpu / len(many.slope)
        some = cells[::3]
        cpu, worst = 0.0, 0.0
        for cell in some:
            rhs, start, back = gear_rivals.problem(cell.slope, drone.start(cell), thrust)
            _, seconds, rival = measured(
                lambda rhs=rhs, start=start: solve_ivp(
                    rhs, (0.0, 3.0), start, method="LSODA", rtol=1e-5, atol=1e-7, dense_output=True
                )
            )
            cpu += seconds / len(some)
            early = np.linspace(0.0, 0.1, 101)
            run = simulate(drone.row, cell.slope, drone.start(cell), early, tolerance=1e-6, propulsion=thrust)
            exact = run.state[:, [0, 1, 2, 7, 8]]
            worst = max(worst, mean_nrmse(back(rival.sol(early).T), exact))
        spent["scipy LSODA, same right-hand side"] = cpu
        base = spent["sysid to 3 s"]
        for name, seconds in spent.items():
            print(f"  {name:<40} {1 / seconds:>10.0f} {1e3 * seconds:>9.3f} {seconds / base:>7.1f}")
        print(f"  LSODA and the kernel agree within {100 * worst:.2f} % NRMSE in the first 0.1 s")
        if worst > SAME:
            raise SystemExit("LSODA does not solve the kernel's problem: the ratio means nothing")


def main():
    """Measure."""
    parser = flags(__doc__, json=False, every=1, maps=False, no_check=False)
    parser.add_argument("--impulse", choices=["lf", "hf"])
    chosen = parser.parse_args()
    settings = MapSettings(check=not chosen.no_check)
    settings = replace(
        settings, slopes_deg=settings.slopes_deg[:: chosen.every], speeds=settings.speeds[:: chosen.every]
    )
    controllers = (find_controller("off"), find_controller("reverse"))
    for surface in ("lf", "hf"):
        prepare(surface)
        land_many(fleet(surface, 1)[0], [Scenario(0.1, 0.1)], controllers[0])
    if chosen.maps:
        wall, cpu, maps = measured(lambda: landing_maps([fleet("lf"), fleet("hf")], controllers, settings))
        count = sum(landings.outcome.size for landings in maps)
        print(
            f"Fig. 8: {count} landings, {wall:.1f} s, {cpu:.1f} s of processor, "
            f"{count / cpu:.0f} per core and second"
        )
        for landings in maps:
            print(f"  {landings.title}: {100 * landings.uncertain.mean():.2f} % uncertain")
    elif chosen.impulse:
        search = ImpulseSettings()
        wall, cpu, (maps, *_) = measured(lambda: impulse_maps([fleet(chosen.impulse)], settings, search))
        best = maps[0].optimum
        pairs = best["delay"].size * search.combinations
        print(
            f"Fig. 9, {chosen.impulse}: {pairs} combinations, {int(best['simulated'].sum())} simulated, "
            f"{wall:.1f} s, {cpu:.1f} s of processor"
        )
    else:
        drone = fleet("lf", 1)[0]
        motors = Motors(drone)
        cells = settings.cells()
        for controller in controllers:
            _, cpu, _ = measured(
                lambda controller=controller: land_many(drone, cells, controller, motors=motors, threads=1)
            )
            rate = len(cells) / cpu
            print(f"map of {len(cells)} landings, {controller.label}: {rate:.0f} per core and second")
        rivals(20)


if __name__ == "__main__":
    main()
