"""Notebooks: thin, small, free of this machine's paths, and what they show is what comes out today."""

import json
import re

import nbformat
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fakes.notebooks import NOTEBOOKS, ORDER, differences, execute, texts
from fakes.places import SAMPLES
from sysid.loaders import load

# Executed in less than 10 s of processor time, with what they read.
QUICK = ("04-python", "the-model")
STORED = {path.stem: path for path in NOTEBOOKS.glob("*.ipynb")}


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_all_notebooks_are_there_and_listed_in_reading_order():
    assert set(STORED) == set(ORDER)
    listed = re.findall(r"\]\(([\w-]+)\.ipynb\)", (NOTEBOOKS / "README.md").read_text(encoding="utf-8"))
    assert listed == list(ORDER)


def test_the_folder_is_small():
    assert sum(path.stat().st_size for path in NOTEBOOKS.rglob("*") if path.is_file()) < 2_000_000


@pytest.mark.parametrize("name", ORDER)
def test_stored_notebooks_are_thin_shown_and_take_parameters(name):
    notebook = nbformat.read(STORED[name], as_version=4)
    nbformat.validate(notebook)
    cells = code(notebook)
    assert sum("parameters" in cell.metadata.get("tags", ()) for cell in cells) == 1
    assert sum(cell.cell_type == "markdown" for cell in notebook.cells) >= 4
    for cell in cells:
        # Prose and calls: whatever computes lives in the package, under test, or is the user's model.
        own = name == "08-a-model-of-your-own" and re.search(r"^def ", cell.source, re.MULTILINE)
        computing = r"^\s*(def|class|for|while|if|with|try|print)\b"
        assert own or not re.search(computing, cell.source, re.MULTILINE)
        assert len(cell.source.splitlines()) <= (20 if name.startswith("08") else 8)
        # Nothing prints; a refusal is shown where the notebook asks for one.
        refusal = "raises-exception" in cell.metadata.get("tags", ())
        kinds = {output.output_type for output in cell.outputs}
        assert kinds <= ({"error"} if refusal else {"execute_result", "display_data"}), cell.source
    assert any("PICTURE" in texts(cell) for cell in cells)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not re.search(
        r"/(home|tmp|root|work|Users|mnt)/|[A-Z]:\\\\", STORED[name].read_text(encoding="utf-8")
    )


@pytest.mark.parametrize("name", ORDER)
def test_links_lead_somewhere(name):
    notebook = nbformat.read(STORED[name], as_version=4)
    prose = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", prose):
        assert (NOTEBOOKS / target).exists(), target


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("notebooks")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in ORDER]
)
def test_executed_again_a_notebook_shows_what_is_stored(folder, name):
    assert differences(nbformat.read(STORED[name], as_version=4), execute(name, folder)) == []


def test_a_difference_is_found():
    stored = nbformat.read(STORED["04-python"], as_version=4)
    assert differences(stored, stored) == []
    other = json.loads(json.dumps(stored))
    text = next(o for c in other["cells"] for o in c.get("outputs", ()) if "0.088" in str(o))
    text["data"]["text/html"] = text["data"]["text/html"].replace("0.088", "0.091")
    changed = differences(stored, nbformat.from_dict(other))
    assert changed
    assert all("0.088" in sentence and "0.091" in sentence for sentence in changed)


def test_the_swings_are_those_of_the_pendulum_that_the_notebook_states():
    for name, release, drag in (("swing-1", 40, 0.0), ("swing-2", 60, 0.0), ("card-5", 70, 0.12)):
        time, angle = np.loadtxt(NOTEBOOKS / "pendulum" / f"{name}.csv", delimiter=",", skiprows=1).T

        def motion(_, state, drag=drag):
            return state[1], -9.81 / 0.62 * np.sin(state[0]) - (0.08 + drag * abs(state[1])) * state[1]

        start = np.deg2rad(release), 0.0
        right = solve_ivp(motion, time[[0, -1]], start, t_eval=time, rtol=1e-9, atol=1e-12).y[0]
        # The standard deviation of 201 samples has an error of 5 %.
        assert np.std(angle - np.rad2deg(right)) == pytest.approx(0.3, rel=0.2)


def test_the_raw_drops_are_sample_drops_in_other_axes():
    samples = {path.name[:6]: path for path in (SAMPLES / "gear-lf").glob("drop-*.csv")}
    for take, drop in (("01", "drop-1"), ("02", "drop-4"), ("03", "drop-5"), ("04", "drop-8")):
        raw = load(NOTEBOOKS / "raw-drops" / f"take-{take}.csv").channels["F450/position"].values
        x, y, z = load(samples[drop]).channels["F450/position"].values.T
        turned = np.column_stack([x, -z, y])
        seen = np.isfinite(raw).all(axis=1)
        assert seen.mean() > 0.95
        # Written to a micrometre.
        np.testing.assert_allclose(raw[seen], turned[seen], rtol=0, atol=1e-6)
