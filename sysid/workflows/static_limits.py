"""Static limits of ranked sets: rigid legs in closed form, the fitted legs on a slow ramp."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sysid.errors import ExportError
from sysid.gear.surfaces import find_surface
from sysid.landing.static_limits import RigidLimits, StaticLimit, ramp_limit, rigid_limits, set_down_limit
from sysid.report.fold import print_result, print_table
from sysid.report.landing_tables import limits_table
from sysid.workflows.show import load_sets


@dataclass(frozen=True)
class SetLimits:
    """Static limits of one set under one thrust.

    Parameters
    ----------
    rank : int
        Of the set; 1 is the best.
    reverse_thrust : float
        Over all motors [N].
    rigid : RigidLimits
    bending, set_down : StaticLimit
        With the set's fitted legs, on a slow ramp and put on the slope at once.
    """

    rank: int
    reverse_thrust: float
    rigid: RigidLimits
    bending: StaticLimit
    set_down: StaticLimit

    def document(self) -> dict[str, object]:
        """Return the numbers ready for JSON, slopes in degrees."""
        return {
            "set": self.rank,
            "reverse thrust [N]": self.reverse_thrust,
            "rigid slide limit [deg]": math.degrees(self.rigid.slide),
            "rigid tip limit [deg]": math.degrees(self.rigid.tip),
            "rigid creep limit [deg]": math.degrees(self.rigid.creep),
            "own legs [deg]": math.degrees(self.bending.slope),
            "own legs": self.bending.how,
            "own legs, set down at once [deg]": math.degrees(self.set_down.slope),
        }


def static_limits(source: str | Path, thrusts: Sequence[float]) -> tuple[str, list[SetLimits]]:
    """Return the name of a gear's sets and the limits of every set under every thrust [N].

    Raises
    ------
    ExportError
        When the sets are not a gear's, or a thrust lifts the drone.
    """
    sets = load_sets(source)
    if sets.kind != "gear":
        raise ExportError(f"{source}: holds {sets.kind} sets; static limits need the sets of a landing gear")
    surface = find_surface(str(sets.settings.get("surface", "lf")))
    rows = []
    for rank in range(1, len(sets) + 1):
        values = sets.set_values(rank)
        for thrust in thrusts:
            rigid = rigid_limits(values, surface, thrust)
            bending = ramp_limit(values, surface, thrust)
            down = set_down_limit(values, surface, thrust)
            rows.append(SetLimits(rank, thrust, rigid, bending, down))
    return sets.name, rows


def print_static_limits(source: str | Path, thrusts: Sequence[float], json: bool = False) -> None:
    """Print the static limits of every set of a fit folder or file."""
    name, rows = static_limits(source, thrusts)
    documents = [row.document() for row in rows]
    if print_result({"name": name, "limits": documents}, json):
        return
    print_table(limits_table(name, documents))
