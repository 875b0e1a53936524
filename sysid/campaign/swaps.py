"""Exchanges of two entries of a campaign, lost signs, and numbers that are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

# Keys and indices that lead to an entry of a campaign: ``("trials", 2, "slope")``.
Place = tuple[str | int, ...]


@dataclass(frozen=True)
class Swap:
    """A likely mistake in writing down a campaign, as what undoes it."""

    # Words for the campaign without the mistake, after "with": ``foot_dx and foot_dz exchanged``.
    title: str
    # Entries to exchange, and numbers with what is added to them.
    exchanged: tuple[tuple[Place, Place], ...] = ()
    moved: tuple[tuple[Place, float], ...] = ()

    @property
    def keys(self) -> set[str | int]:
        """Last keys of the entries that it changes: ``{"slope"}`` where slopes are exchanged."""
        places = [*(place for pair in self.exchanged for place in pair), *(place for place, _ in self.moved)]
        return {place[-1] for place in places}

    def undone(self, campaign: Any) -> Any:
        """Return a campaign without the mistake."""
        out = campaign
        for one, other in self.exchanged:
            out = _with(out, one, _at(campaign, other))
            out = _with(out, other, _at(campaign, one))
        for place, way in self.moved:
            out = _with(out, place, _at(campaign, place) + way)
        return out


def _at(node: Any, place: Place) -> Any:
    for key in place:
        node = node[key] if isinstance(key, int) else getattr(node, key)
    return node


def _with(node: Any, place: Place, value: Any) -> Any:
    if not place:
        return value
    key, rest = place[0], place[1:]
    if isinstance(node, BaseModel):
        return node.model_copy(update={str(key): _with(getattr(node, str(key)), rest, value)})
    return tuple(_with(one, rest, value) if i == key else one for i, one in enumerate(node))
