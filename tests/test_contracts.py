"""The house rules that a machine can hold: imports point down, in no circle, at the top of a file; kernels
are pure; nothing is pickled; start-up stays light.
"""

import ast
import hashlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from fakes.places import ROOT

PACKAGE = ROOT / "sysid"
FILES = sorted(PACKAGE.rglob("*.py"))
# Rooms from the top down; those of one line do not import each other.
ROOMS = (
    "cli | api api_landing api_model testing",
    "workflows",
    "report",
    "landing | synthetic | export",
    "gear | motor | own",
    "integrate",
    "trust",
    "fit",
    "parameter_sets",
    "trials",
    "campaign",
    "loaders",
    "filters",
    "recording | parameters",
    "storage resume units parallel documents exact_json marks search_options",
    "journal",
    "errors | types | interrupt | shown",
)


def module_of(path: Path) -> str:
    """Return the name of a module."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in FILES}


def imports_of(tree: ast.AST, module: str) -> Iterator[tuple[str, int, bool]]:
    """Return every module that a file imports, for types alone too, its line, whether in a function."""

    def walk(node: ast.AST, local: bool) -> Iterator[tuple[str, int, bool]]:
        for child in ast.iter_child_nodes(node):
            # The face of the package shows type checkers what it loads only when it is asked for.
            if module == "sysid" and isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
                continue
            if isinstance(child, ast.Import):
                yield from ((one.name, child.lineno, local) for one in child.names)
            elif isinstance(child, ast.ImportFrom) and child.module:
                for one in child.names:
                    inner = f"{child.module}.{one.name}"
                    yield (inner if inner in MODULES else child.module), child.lineno, local
            functions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
            yield from walk(child, local or isinstance(child, functions))

    for name, line, local in walk(tree, False):
        if name.split(".")[0] == "sysid" and name != module:
            yield name, line, local


def graph(sources: dict[str, str]) -> dict[str, list[tuple[str, int, bool]]]:
    """Return the imports of every module, those inside functions too."""
    return {name: list(imports_of(ast.parse(text), name)) for name, text in sources.items()}


def circles(imports: dict[str, list[tuple[str, int, bool]]]) -> list[str]:
    """Return the modules of a circle of imports, each imported by the next one; none without a circle."""
    try:
        TopologicalSorter({name: [other for other, *_ in found] for name, found in imports.items()}).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def climbs(imports: dict[str, list[tuple[str, int, bool]]]) -> list[str]:
    """Return the imports that point up, or to a room beside."""
    floor, beside = {}, {}
    for level, line in enumerate(ROOMS):
        for part in line.split(" | "):
            for room in part.split():
                floor[room], beside[room] = level, part
    out = []
    for name, others in imports.items():
        room = [*name.split("."), ""][1]
        for other, line, _ in others:
            target = [*other.split("."), ""][1]
            if room not in floor or target not in floor or target == room:
                continue
            up = floor[target] < floor[room]
            if up or (floor[target] == floor[room] and beside[target] != beside[room]):
                out.append(f"{name}:{line} imports {other}")
    return out


# Loads pymoo or cma only for the algorithm that a fit asks for: half a second of every start. So does `show`
# with the campaign of a fit that was cut short, the words on `explain` and the table of a new fit.
LAZY = ("sysid.fit.breeders.algorithms", "sysid.workflows.show")


def local_imports(imports: dict[str, list[tuple[str, int, bool]]]) -> list[str]:
    """Return the imports of sysid inside functions, but for the command line and `__init__`."""
    return [
        f"{name}:{line} imports {other}"
        for name, others in imports.items()
        for other, line, local in others
        if local
        and not name.startswith("sysid.cli")
        and MODULES[name].name != "__init__.py"
        and name not in LAZY
    ]


# The same function of two models: the two kinds are strangers, so each has its own.
TWINS = {"pack", "simulate", "simulate_population"}
# A kernel names its steps for itself; a command, and what Python offers, are named after what they call.
APART = ("sysid.api", "sysid.cli", "sysid.gear.kernel", "sysid.gear.surfaces", "sysid.motor.kernel")


def ambiguous_names(sources: dict[str, str]) -> dict[str, list[str]]:
    """Return every public class and function that more than one module defines, with these modules."""
    homes: dict[str, list[str]] = {}
    for module, text in sources.items():
        for node in () if module.startswith(APART) else ast.parse(text).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(module)
    return {name: modules for name, modules in homes.items() if len(modules) > 1 and name not in TWINS}


@pytest.fixture(scope="module")
def sources():
    return {name: path.read_text(encoding="utf-8") for name, path in MODULES.items()}


@pytest.fixture(scope="module")
def imports(sources):
    return graph(sources)


def test_no_import_circles(imports):
    assert circles(imports) == []


def test_rooms_import_downward(imports):
    assert climbs(imports) == []


def test_no_imports_inside_functions(imports):
    assert local_imports(imports) == []


def test_a_public_name_has_one_meaning(sources):
    assert ambiguous_names(sources) == {}


@pytest.mark.parametrize(
    ("module", "line", "rule"),
    [
        ("sysid.fit.result", "def f():\n    import sysid.fit.problem\n", circles),
        ("sysid.fit.trial", "if TYPE_CHECKING:\n    from sysid.fit.problem import Problem\n", circles),
        ("sysid.fit.problem", "import sysid.gear.problem\n", climbs),
        ("sysid.gear.problem", "import sysid.motor.problem\n", climbs),
        ("sysid.trust.verdicts", "def f():\n    from sysid.trust import documents\n", local_imports),
    ],
)
def test_a_planted_violation_is_seen(sources, imports, module, line, rule):
    planted = graph({module: f"{sources[module]}\n{line}"})
    assert len(rule({**imports, **planted})) > len(rule(imports))


def test_import_contracts():
    pytest.importorskip("importlinter", reason="import-linter comes with the test extra")
    from importlinter.cli import lint_imports

    assert lint_imports(config_filename=str(ROOT / ".importlinter"), no_cache=True) == 0


def test_a_wheel_has_every_file_of_the_package():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    packed = {path for pattern in settings["package-data"]["sysid"] for path in PACKAGE.glob(pattern)}
    others = {path for path in PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert {path for path in others - packed if path.suffix != ".py"} == set()
    assert {path.parent for path in FILES} == {path.parent for path in PACKAGE.rglob("__init__.py")}


def test_contributing_lists_what_sysid_stands_on():
    """Every dependency with purpose, company and licence; bundled JavaScript with version and hash."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [
        *project["dependencies"],
        *(name for extra in project["optional-dependencies"].values() for name in extra),
    ]
    names = {re.match(r"[\w-]+", text)[0] for text in stated} - {project["name"]}
    # CI installs one version of each, at least the lowest that is allowed.
    constraints = (ROOT / ".ci/constraints.txt").read_text(encoding="utf-8").splitlines()[1:]
    fixed = {canonicalize_name(line.name): line for line in map(Requirement, constraints)}
    assert all(re.fullmatch(r"==[\w.]+", str(line.specifier)) for line in fixed.values())
    for allowed in map(Requirement, stated):
        if allowed.name != project["name"]:
            version = str(fixed[canonicalize_name(allowed.name)].specifier).removeprefix("==")
            assert allowed.specifier.contains(version), allowed
    text = (ROOT / ".github/CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text.partition("### What sysid stands on")[2].partition("\n### ")[0]
    rows = [row.strip("|").split("|") for row in table.splitlines() if row.startswith("| ")]
    listed = [name.strip() for cells in rows if len(cells) == 4 for name in cells[0].split(",")]
    assert sorted(listed) == sorted({*names, "package"})
    assert all(cell.strip() for cells in rows for cell in cells)
    (version,) = re.findall(r"uPlot (\d+\.\d+\.\d+) \(MIT", table)
    folder = PACKAGE / "report/page"
    assert f"(v{version})" in (folder / "uplot.min.js").read_text(encoding="utf-8")[:80]
    hashes = dict(re.findall(r"\| `(\S+)` \| `([0-9a-f]{64})` \|", table))
    assert hashes == {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.min.*")
    }


def test_no_pickle_and_no_eval(sources):
    forbidden = (
        "import pickle",
        "import dill",
        "import cloudpickle",
        "allow_pickle=True",
        " eval(",
        "joblib",
    )
    for name, text in sources.items():
        found = [word for word in forbidden if word in text]
        assert not found, f"{name} holds {found}"


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("sysid.cli", ("numpy", "numba", "pymoo", "pandas", "matplotlib", "scipy", "h5py")),
        ("sysid.export", ("numba", "pymoo", "pandas")),
        # `sysid show` takes half a second of processor time; any of these modules would take as long.
        ("sysid.workflows.show", ("scipy", "numba", "pandas", "matplotlib")),
        ("sysid.workflows.fits", ("scipy", "numba", "pandas", "matplotlib")),
        ("sysid.report.fit_figures", ("matplotlib.pyplot",)),
    ],
)
def test_what_starts_often_imports_nothing_slow(module, heavy):
    code = f"import sys, {module}; print(*({{*{heavy}}} & {{*sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
