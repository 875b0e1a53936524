"""Every warning has a code, and every code an explanation."""

import ast
import re
from pathlib import Path

import sysid
from sysid.workflows.codes import CODES

SOURCE = Path(sysid.__file__).parent
# Position of the code among the arguments of what makes warnings.
MAKERS = {"notice": 0, "Finding": 0, "about": 1, "_notice": 0, "_hold": 0}


def emitted():
    """Yield every code that the source gives a warning, as a pattern, with its place."""
    for path in sorted(SOURCE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef):
                yield from of_function(function, path.relative_to(SOURCE).as_posix())


def of_function(function, path):
    given = {arg.arg for arg in (*function.args.args, *function.args.kwonlyargs)}
    assigned = {
        target.id: node.value
        for node in ast.walk(function)
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for call in ast.walk(function):
        if not isinstance(call, ast.Call):
            continue
        name = getattr(call.func, "id", getattr(call.func, "attr", ""))
        at = MAKERS.get(name)
        note = len(call.args) > 2 and ast.unparse(call.args[2]) == "'note'"
        if at is None or note or len(call.args) <= at:
            continue
        # Of `_notice` in gear/plausible.py the second argument completes the code.
        code = call.args[1] if (name, path) == ("_notice", "gear/plausible.py") else call.args[at]
        whole = "contradicts-{}" if (name, path) == ("_notice", "gear/plausible.py") else "{}"
        if isinstance(code, ast.Name) and code.id not in given:
            code = assigned[code.id]
        if isinstance(code, ast.JoinedStr):
            parts = (re.escape(p.value) if isinstance(p, ast.Constant) else r"[\w-]+" for p in code.values)
            yield "".join(parts), f"{path}:{call.lineno}"
        elif isinstance(code, ast.IfExp):
            yield from ((whole.format(one.value), path) for one in (code.body, code.orelse))
        elif isinstance(code, ast.Constant):
            yield whole.format(re.escape(code.value)), f"{path}:{call.lineno}"
        else:
            # The code of another finding, or an argument of the function.
            text = ast.unparse(code)
            assert text.endswith(".code") or text in (*given, "str(one['code'])"), f"{path}: {text}"


def test_every_code_of_a_warning_is_explained_and_every_explanation_is_of_a_code():
    found = list(emitted())
    assert len(found) > 100
    missing = [(code, at) for code, at in found if not any(re.fullmatch(code, one) for one in CODES)]
    assert missing == []
    assert [one for one in CODES if not any(re.fullmatch(code, one) for code, _ in found)] == []
    for code, text in CODES.items():
        assert re.fullmatch(r"[a-z0-9-]+", code)
        assert re.fullmatch(r"[A-Z].*\.", text), code


def test_a_warning_ends_with_its_code_and_the_code_is_explained(run, refused, tmp_path):
    log = tmp_path / "thrust.csv"
    rows = [f"{0.01 * k},{1000 + k},{5000.0 + k}" for k in range(200)]
    log.write_text("\n".join(["time [s],speed [rad/s],thrust [N]", *rows]), encoding="utf-8")
    code, out, _ = run("inspect", log)
    assert code == 0
    assert re.search(r"suspicious: .*probably grams.* \[thrust-unit\]", " ".join(out.split()))
    assert run("codes", "thrust-unit") == (0, f"{CODES['thrust-unit']}\n", "")
    assert run("codes", "[thrust-unit]")[1].startswith("Stands often write grams.")
    refused(["unknown code 'thrust-units'; did you mean thrust-unit"], "codes", "thrust-units")
    refused(["unknown code 'zzz'; sysid codes lists all"], "codes", "zzz")
