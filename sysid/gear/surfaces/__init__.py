"""Friction laws, one file each: every module of this folder that defines `SURFACE` adds a surface."""

import importlib
import pkgutil

from sysid.errors import CampaignError
from sysid.gear.surfaces.surface import LAW_SLOTS, Surface, continuous_law

__all__ = ["LAW_SLOTS", "SURFACES", "Surface", "continuous_law", "find_surface"]


def _discover() -> dict[str, Surface]:
    surfaces = {}
    for module in pkgutil.iter_modules(__path__):
        declared = getattr(importlib.import_module(f"{__name__}.{module.name}"), "SURFACE", None)
        if isinstance(declared, Surface):
            surfaces[declared.name] = declared
    # The two surfaces of the paper come first, whatever their files are called.
    return dict(sorted(surfaces.items(), key=lambda item: (item[0] not in ("lf", "hf"), item[0] == "hf")))


SURFACES = _discover()


def find_surface(surface: str | Surface) -> Surface:
    """Return a surface by name, or the surface itself; raises CampaignError when there is none."""
    if isinstance(surface, Surface):
        return surface
    if surface not in SURFACES:
        raise CampaignError(f"surface: no friction law {surface!r}; known are {', '.join(SURFACES)}")
    return SURFACES[surface]
