"""Sets as models of other simulators: MuJoCo for a landing gear, Gazebo for a motor; one file per set."""

from __future__ import annotations

import math
from pathlib import Path

from sysid.errors import ExportError
from sysid.export.gazebo import MotorPlugin, to_sdf
from sysid.export.mjcf import to_mjcf
from sysid.gear.surfaces import find_surface
from sysid.motor.nearest_lag import first_order_rotor
from sysid.parameter_sets import ParameterSets
from sysid.storage import write_file

# What a suffix is, and whose sets it takes.
MODELS = {".xml": ("a MuJoCo model", "gear"), ".sdf": ("a Gazebo motor model", "motor")}


def export_models(
    sets: ParameterSets,
    target: Path,
    *,
    rank: int | None = None,
    slope: float = 0.0,
    per_leg: bool = False,
    force: bool = False,
) -> list[Path]:
    """Write sets as models of another simulator, `target`'s suffix says which.

    Parameters
    ----------
    sets : ParameterSets
    target : Path
        Ends in ``.xml`` or ``.sdf``. Several sets go to ``NAME-1.xml``, ``NAME-2.xml`` ..., by rank.
    rank : int, optional
        Only this set, to `target` itself; 1 is the best.
    slope : float
        Of the ground [rad] (MuJoCo).
    per_leg : bool
        Four single legs in space instead of two pairs in a plane (MuJoCo).
    force : bool
        Replace existing files.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ExportError
        When the sets are of the other kind, a file exists, or a set is not complete; nothing is written then.
    """
    suffix = target.suffix.lower()
    what, kind = MODELS[suffix]
    if sets.kind != kind:
        raise ExportError(
            f"{target}: {what} needs the sets of a {kind}; {sets.name} holds those of a {sets.kind}"
        )
    if suffix == ".sdf" and (per_leg or slope):
        raise ExportError(f"{target}: --per-leg and --slope-deg are for MuJoCo models (.xml); leave them out")
    if not target.parent.is_dir():
        raise ExportError(f"{target}: the folder {target.parent} does not exist; make it first")
    ranks = [rank] if rank is not None else list(range(1, len(sets) + 1))
    alone = rank is not None or len(sets) == 1
    files = [target if alone else target.with_name(f"{target.stem}-{i}{target.suffix}") for i in ranks]
    for file in files:
        if file.exists() and not force:
            raise ExportError(f"{file}: exists already; choose a new name or add --force")
    sticks = kind == "gear" and find_surface(str(sets.settings.get("surface", "lf"))).switching
    documents = [
        _motor(sets, i)
        if kind == "motor"
        else to_mjcf(
            sets.set_values(i), name=f"{sets.name} set {i}", sticks=sticks, slope=slope, per_leg=per_leg
        )
        for i in ranks
    ]
    for file, document in zip(files, documents, strict=True):
        write_file(file, document, ExportError)
    return files


def _motor(sets: ParameterSets, rank: int) -> bytes:
    values = sets.set_values(rank)
    wrong = [name for name, value in values.items() if math.isnan(value)]
    if wrong:
        raise ExportError(
            f"{sets.name}, set {rank}: {', '.join(wrong)} unknown (NaN); record what fixes it and fit again"
        )
    rotor = first_order_rotor(values)
    notes = [
        f"{sets.name}, set {rank} of {len(sets)}.",
        f"Time constants: the lag nearest to the motor's own response to command steps up and down around "
        f"hover, off by {100 * rotor.misfit_up:.1f} % and {100 * rotor.misfit_down:.1f} % of a step (rms).",
        f"Thrust: {100 * rotor.thrust_misfit:.1f} % of the largest off the identified curve at worst.",
        f"Reverse rotation is weaker, which the plugin does not know: motorConstant "
        f"{rotor.reverse_thrust_constant:.4g} N s^2/rad^2 up to {rotor.reverse_maximum_speed:.4g} rad/s; nor "
        "does it know the pause of a reversal (saturation current and speed).",
    ]
    lag = next((r for r in sets.settings.get("ladder", ()) if r["rung"] == "first-order lag"), None)
    if lag is not None:
        up, down = (lag["values"][f"{way}_time_constant"] for way in ("rise", "fall"))
        notes.append(f"Fitted to the logs themselves, a lag has {up:.4g} s up and {down:.4g} s down.")
    plugin = MotorPlugin(
        timeConstantUp=rotor.time_constant_up,
        timeConstantDown=rotor.time_constant_down,
        maxRotVelocity=rotor.maximum_speed,
        motorConstant=rotor.thrust_constant,
        momentConstant=rotor.moment_constant,
    )
    return to_sdf(plugin, name=f"{sets.name}-{rank}", notes=tuple(notes))
