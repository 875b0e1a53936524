"""Export of ranked sets: as parameter-set files, or one model of another simulator for each set."""

from __future__ import annotations

from pathlib import Path

from sysid.errors import ExportError
from sysid.export import export
from sysid.export.gazebo import to_sdf
from sysid.export.mjcf import to_mjcf
from sysid.fit.adequacy import NOT_BY
from sysid.gear.surfaces import find_surface
from sysid.journal import notice
from sysid.motor.nearest_lag import first_order_rotor
from sysid.parameter_sets import ADEQUACY, ParameterSets
from sysid.storage import check_file, write_file
from sysid.workflows.show import load_sets

# The simulator of a suffix, and the kind of sets that it takes.
MODELS = {".xml": ("a MuJoCo model", "gear"), ".sdf": ("a Gazebo motor model", "motor")}


def export_sets(
    source: str | Path,
    target: Path,
    force: bool = False,
    *,
    rank: int | None = None,
    slope: float = 0.0,
    per_leg: bool = False,
) -> list[Path]:
    """Write the ranked sets of a fit folder or file, and return the files; the suffix chooses the format.

    Several sets become several models, ``NAME-1.xml``, ``NAME-2.xml`` ..., by rank; with a `rank` only that
    set is written, to `target` itself. For MuJoCo, `slope` is the ground's [rad], and `per_leg` models four
    single legs in space instead of two pairs in a plane. Raises `ExportError` when the sets do not suit the
    simulator, or a file exists or cannot be written; old files survive.
    """
    sets = load_sets(source)
    if sets.provenance.get(ADEQUACY, {}).get("verdict") == NOT_BY:
        notice(
            "not-explained",
            f"{source}: the model does not explain the trials, so no parameter is well known",
        )
    suffix = target.suffix.lower()
    if suffix not in MODELS:
        if rank is not None or slope or per_leg:
            raise ExportError(
                f"{target}: --set, --slope and --per-leg are for models of other simulators (.xml, .sdf); "
                "leave them out"
            )
        check_file(target, force=force, error_type=ExportError)
        return [export(sets, target)]
    if suffix == ".sdf" and (per_leg or slope):
        raise ExportError(f"{target}: --per-leg and --slope are for MuJoCo models (.xml); leave them out")
    what, kind = MODELS[suffix]
    if sets.kind != kind:
        raise ExportError(f"{target}: {what} needs the sets of a {kind}; {sets.name} has {sets.kind} sets")
    documents: dict[Path, bytes] = {}
    for i in [rank] if rank is not None else range(1, len(sets) + 1):
        alone = rank is not None or len(sets) == 1
        file = target if alone else target.with_name(f"{target.stem}-{i}{target.suffix}")
        check_file(file, force=force, error_type=ExportError)
        if suffix == ".sdf":
            documents[file] = _motor(sets, i)
            continue
        sticks = find_surface(str(sets.settings.get("surface", "lf"))).switching
        documents[file] = to_mjcf(
            sets.set_values(i), name=f"{sets.name} set {i}", sticks=sticks, slope=slope, per_leg=per_leg,
            notes=_certainty(sets),
        )  # fmt: skip
    for file, document in documents.items():
        write_file(file, document, ExportError)
    return list(documents)


def _certainty(sets: ParameterSets) -> list[str]:
    """Return what a reader of a model must know: does noise explain the fit, what is each value worth."""
    out = []
    if judged := sets.provenance.get("adequacy"):
        out.append(f"Fit {judged['sentence']}.")
    for name, row in sets.known.items():
        if row.judged:
            verdict = row.judged.verdict.replace("_", " ")
            out.append(f"{name} [{row.record.unit}]: 95 % interval {row.judged.interval}, {verdict}.")
    return out


def _motor(sets: ParameterSets, rank: int) -> bytes:
    rotor = first_order_rotor(sets.set_values(rank).known())
    notes = [
        f"{sets.name}, set {rank} of {len(sets)}.",
        *_certainty(sets),
        f"Time constants: the lag nearest to the motor's response to command steps up and down around "
        f"hover, off by {100 * rotor.misfit_up:.1f} % and {100 * rotor.misfit_down:.1f} % of a step (rms).",
        f"Thrust: {100 * rotor.thrust_misfit:.1f} % of the largest off the identified curve at worst.",
        f"Reverse rotation is weaker, which the plugin does not know: motorConstant "
        f"{rotor.reverse_thrust_constant:.4g} N s^2/rad^2 up to {rotor.reverse_maximum_speed:.4g} rad/s; nor "
        "does it know the pause of a reversal (saturation current and speed).",
    ]
    return to_sdf(rotor, name=f"{sets.name}-{rank}", notes=tuple(notes))
