"""Python files of a user: what they register is known afterwards."""

import importlib.util
import sys
import traceback
from pathlib import Path

from sysid.errors import CampaignError, SysidError

# Files that --plugin names, which the next commands need as well.
NAMED: list[Path] = []


def run_file(path: Path, which: str) -> None:
    """Run a user's Python file `which` registers something; CampaignError where it cannot be run."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise CampaignError(f"{path}: no Python file; give one {which}")
    module = importlib.util.module_from_spec(spec)
    # Numba and dataclasses look for the module of a function.
    sys.modules.setdefault(path.stem, module)
    try:
        spec.loader.exec_module(module)
    except SysidError:
        raise
    except Exception as error:
        raise CampaignError(f"{fault_of(path, error)}; mend that file") from error


def fault_of(path: Path, error: Exception) -> str:
    """Say where in a user's file an error came from, and what it is."""
    file = str(path.absolute())
    if isinstance(error, SyntaxError) and error.filename == file:
        return f"{path}, line {error.lineno}: {error.msg}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    first = next(iter(str(error).splitlines()), "")
    what = f"{type(error).__name__}: {first}" if first else type(error).__name__
    return f"{path}, line {lines[-1]}: {what}" if lines else f"{path}: {what}"
