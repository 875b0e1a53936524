"""Static limits of ranked sets: rigid legs in closed form, the fitted legs set down at once."""

import math
from collections.abc import Sequence
from pathlib import Path

from sysid.errors import ExportError
from sysid.export import load_parameter_sets
from sysid.gear.surfaces import find_surface
from sysid.landing.static_limits import rigid_limits, set_down_limit
from sysid.parameter_sets import ParameterSets
from sysid.report.fold import print_result, print_table
from sysid.report.landing_tables import limits_table


def print_static_limits(source: str | Path, thrusts: Sequence[float], json: bool = False) -> None:
    """Print the static limits of every set of a gear under every thrust [N]."""
    sets = load_parameter_sets(source)
    rows = limit_rows(sets, thrusts, str(source))
    if not print_result({"name": sets.name, "limits": rows}, json):
        print_table(limits_table(sets.name, rows))


def limit_rows(sets: ParameterSets, thrusts: Sequence[float], name: str) -> list[dict[str, object]]:
    """Return the static limits of every set under every thrust [N].

    Rigid legs, then the fitted ones of the set, put on the slope at once. Raises `ExportError`, which names
    the sets, when they are not a gear's, or a thrust lifts the drone.
    """
    if sets.kind != "gear":
        raise ExportError(f"{name}: has {sets.kind} sets; static limits need the sets of a landing gear")
    surface = find_surface(str(sets.settings.get("surface", "lf")))
    rows: list[dict[str, object]] = []
    for rank in range(1, len(sets) + 1):
        values = sets.set_values(rank)
        for thrust in thrusts:
            rigid, put = rigid_limits(values, surface, thrust), set_down_limit(values, surface, thrust)
            rows.append({
                "set": rank,
                "reverse_thrust": thrust,
                "rigid_slide_deg": math.degrees(rigid.slide),
                "rigid_tip_deg": math.degrees(rigid.tip),
                "rigid_creep_deg": math.degrees(rigid.creep),
                "set_down_deg": math.degrees(put.slope),
                "set_down_how": put.how,
            })  # fmt: skip
    return rows
