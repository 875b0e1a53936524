"""Fits of the samples for reports, and notebooks without a kernel: their cells run one after the other."""

import ast
import contextlib
import json

from fakes.places import ROOT, SAMPLES
from sysid.report.html import Html, joined, page
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions

NOTEBOOKS = ROOT / "notebooks"
# Searches that end at once, and few cells: the pages do not depend on how good the numbers are.
SHORT = {"quiet": True, "runs": 2, "population": 16, "max_generations": 3, "finish": "none"}
COARSE = {"slopes": "0:45:15", "speeds": "0.3,1", "impulse_slopes": "10,25", "impulse_speeds": "0.5"}


def short_fits(folder):
    """Fit both gears and the motor of the samples; return the folders by name."""
    return {
        name: fit_campaign(SAMPLES / name / "campaign.toml", FitOptions(folder / name, **SHORT, trust=False))[
            1
        ]
        for name in ("gear-lf", "gear-hf", "motor")
    }


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
