"""Export of ranked sets: as parameter-set files, or one model of another simulator for each set."""

import sys
from pathlib import Path

from sysid import exact_json
from sysid.errors import ExportError
from sysid.export import SUFFIXES, export
from sysid.export.mjcf import to_mjcf
from sysid.export.numbers import numbers_for
from sysid.export.xml import document
from sysid.fit.adequacy import NOT_BY
from sysid.gear.surfaces import find_surface
from sysid.journal import notice
from sysid.motor.nearest_lag import FirstOrderRotor
from sysid.parameter_sets import ADEQUACY, ParameterSets
from sysid.storage import check_file, write_file
from sysid.workflows.draws import sets_or_draws

# The simulator of a suffix, and the kind of sets that it takes.
MODELS = {".xml": ("a MuJoCo model", "gear"), ".sdf": ("a Gazebo motor model", "motor")}


def print_exported(
    source: str | Path, out: Path | None, force: bool, json: bool, *, target: str | None = None,
    mass: float | None = None, rank: int | None = None, slope: float = 0.0, per_leg: bool = False,
    draws: int | None = None,
) -> None:  # fmt: skip
    """Print a motor's numbers for a `target`, write them or the sets to `out`, and print what was written.

    For Gazebo an .sdf file is the whole model of the set whose numbers are printed. `mass` is a drone's [kg];
    other arguments and errors as for `export_sets`.
    """
    if target is None:
        if out is None or mass is not None:
            raise ExportError(
                "give --out FILE to write the sets, or --for with a simulator or flight controller, such as "
                "gazebo, to print a motor's numbers by its names; --mass goes with --for"
            )
        files = export_sets(source, out, force, rank=rank, slope=slope, per_leg=per_leg, draws=draws)
        numbers = None
    else:
        if draws is not None:
            raise ExportError("--for prints the numbers of one set; leave --draws out, or give --out alone")
        if slope or per_leg:
            raise ExportError(
                "--slope and --per-leg are for MuJoCo models (.xml), not for --for; leave them out"
            )
        numbers = numbers_for(_sets(source), target, rank=rank or 1, mass=mass)
        for sentence in numbers.missing:
            notice("not-given", sentence)
        suffix = "" if out is None else out.suffix.lower()
        if suffix in SUFFIXES or (suffix in MODELS and (target, suffix) != ("gazebo", ".sdf")):
            raise ExportError(
                f"{out}: --for {target} writes the text that it prints; leave --for out to write the sets, "
                "or take another suffix, such as .txt"
            )
        files = []
        if out is not None and suffix in MODELS:
            files = export_sets(source, out, force, rank=numbers.rank, mass=mass)
        elif out is not None:
            check_file(out, force=force, error_type=ExportError)
            write_file(out, numbers.text().encode("utf-8"), ExportError)
            files = [out]
    written = [str(file) for file in files]
    if json:
        print(exact_json.dumps({"written": written} | (numbers.document() if numbers else {})))
        return
    if numbers:
        print(numbers.text(), end="")
    for file in written:
        print(f"wrote {file}", file=sys.stderr if numbers else None)


def _sets(source: str | Path | ParameterSets, draws: int | None = None) -> ParameterSets:
    """Return the sets of a fit folder or file, or draws; notice where the model does not explain them."""
    sets = source if isinstance(source, ParameterSets) else sets_or_draws(source, draws)
    if sets.provenance.get(ADEQUACY, {}).get("verdict") == NOT_BY:
        seen = "; thrust, torque and time constants of the stand do not depend on it"
        notice(
            "not-explained",
            f"{sets.name if sets is source else source}: the model does not explain the trials, so no "
            "parameter is well known" + seen * bool(sets.settings.get("stand")),
        )
    return sets


def export_sets(
    source: str | Path | ParameterSets,
    target: Path,
    force: bool = False,
    *,
    rank: int | None = None,
    slope: float = 0.0,
    per_leg: bool = False,
    mass: float | None = None,
    draws: int | None = None,
) -> list[Path]:
    """Write ranked sets, or those of a fit folder or file, and return the files; the suffix chooses how.

    Several sets become several models, ``NAME-1.xml``, ``NAME-2.xml`` ..., by rank; with a `rank` only that
    set is written, to `target` itself. With `draws`, that number of draws of a fit replaces its sets.
    For MuJoCo, `slope` is the ground's [rad], and `per_leg` models four single legs in space instead of two
    pairs in a plane; `mass` as in `numbers_for`. Raises `ExportError` when the sets do not suit the
    simulator, or a file exists or cannot be written; old files survive.
    """
    sets = _sets(source, draws)
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
            documents[file] = _motor(sets, i, mass)
            continue
        sticks = find_surface(str(sets.settings.get("surface", "lf"))).switching
        documents[file] = to_mjcf(
            sets.set_values(i), name=f"{sets.name} set {i}", sticks=sticks, slope=slope, per_leg=per_leg,
            notes=_certainty(sets),
        )  # fmt: skip
    for file, content in documents.items():
        write_file(file, content, ExportError)
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


def _motor(sets: ParameterSets, rank: int, mass: float | None) -> bytes:
    numbers = numbers_for(sets, "gazebo", rank=rank, mass=mass)
    if numbers.missing:
        raise ExportError(f"{sets.name}, set {rank}: {numbers.missing[0]}")
    rotor = FirstOrderRotor(sets.set_values(rank))
    head = f"{sets.name}, set {rank} of {len(sets)}."
    # Without repeats, because both say how well the fit explains its logs.
    notes = list(dict.fromkeys((head, *numbers.notes, *_certainty(sets))))
    if rotor.reverse_thrust_constant > 0:
        notes.append(
            f"Reverse rotation is weaker, which the plugin does not know: motorConstant "
            f"{rotor.reverse_thrust_constant:.4g} N s^2/rad^2 up to {rotor.reverse_maximum_speed:.4g} rad/s; "
            "nor does it know the pause of a reversal (saturation current and speed)."
        )
    return document("gazebo.sdf.j2", numbers=numbers, name=f"{sets.name}-{rank}", notes=notes)
