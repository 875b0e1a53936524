"""Libraries of single formats, which an installation need not have."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from sysid.errors import LogError


def library(path: str, module: str, package: str) -> ModuleType:
    """Return an optional library.

    Parameters
    ----------
    path : str
        The log that needs it, named in the message.
    module, package : str
        What is imported, and what is installed.

    Raises
    ------
    LogError
        When it is not installed; the message names the extra that brings it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise LogError(
            f"{path}: reading this format needs {package} ({error}); install it with: "
            'python -m pip install "sysid[logs]"'
        ) from error
