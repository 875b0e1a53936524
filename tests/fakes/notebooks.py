"""Notebooks without a kernel: their cells run in one process, one after the other."""

import ast
import contextlib
import json

from fakes.places import ROOT
from sysid.report.html import Html, joined, page

NOTEBOOKS = ROOT / "notebooks"


def notebook_page(name, parameters):
    """Return what the cells of a notebook show, as a page; `parameters` replace those of the tagged cell."""
    path = NOTEBOOKS / f"{name}.ipynb"
    shown, names = [], {}
    with contextlib.chdir(path.parent):
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            if cell["cell_type"] != "code":
                continue
            body = ast.parse("".join(cell["source"])).body
            last = body.pop() if isinstance(body[-1], ast.Expr) else None
            exec(compile(ast.Module(body, []), path.name, "exec"), names)
            if "parameters" in cell["metadata"].get("tags", ()):
                names.update(parameters)
            if last is not None:
                shown.append(eval(compile(ast.Expression(last.value), path.name, "eval"), names))
    return page(name, joined([piece for piece in shown if isinstance(piece, Html)]))
