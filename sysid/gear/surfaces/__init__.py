"""Friction laws, one file each: every module here that holds a `SURFACE` is a surface of its name."""

from __future__ import annotations

import importlib
import pkgutil

from sysid.errors import CampaignError
from sysid.gear.surfaces.surface import LAW_SLOTS, Surface, continuous_law

__all__ = ["LAW_SLOTS", "SURFACES", "Surface", "continuous_law", "find_surface"]


def _discover() -> dict[str, Surface]:
    found = {}
    for module in pkgutil.iter_modules(__path__):
        declared = getattr(importlib.import_module(f"{__name__}.{module.name}"), "SURFACE", None)
        if isinstance(declared, Surface):
            found[declared.name] = declared
    # The paper's own two first, whatever their files are called.
    return dict(sorted(found.items(), key=lambda item: (item[0] not in ("lf", "hf"), item[0] == "hf")))


SURFACES = _discover()


def find_surface(surface: str | Surface) -> Surface:
    """Return a surface by name, or the surface itself.

    Raises
    ------
    CampaignError
        When there is no such surface.
    """
    if isinstance(surface, Surface):
        return surface
    if surface not in SURFACES:
        raise CampaignError(f"surface: no friction law {surface!r}; known are {', '.join(SURFACES)}")
    return SURFACES[surface]
