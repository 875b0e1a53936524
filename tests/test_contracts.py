"""The house rules that a machine can hold: imports point down, nothing is pickled, start-up stays light."""

import subprocess
import sys

import pytest

from fakes.places import ROOT


def test_imports_point_down():
    pytest.importorskip("importlinter", reason="import-linter comes with the test extra")
    from importlinter.cli import lint_imports

    assert lint_imports(config_filename=str(ROOT / ".importlinter"), no_cache=True) == 0


def test_no_pickle_and_no_eval():
    forbidden = (
        "import pickle",
        "import dill",
        "import cloudpickle",
        "allow_pickle=True",
        " eval(",
        "joblib",
    )
    for path in (ROOT / "sysid").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        found = [word for word in forbidden if word in text]
        assert not found, f"{path.relative_to(ROOT)} holds {found}"


@pytest.mark.parametrize("heavy", ["numba", "pymoo", "pandas", "matplotlib", "scipy", "h5py"])
def test_importing_sysid_is_light(heavy):
    code = f"import sys, sysid, sysid.cli; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
