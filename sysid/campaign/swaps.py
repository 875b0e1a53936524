"""Exchanges of two entries of a campaign, lost signs, and numbers that are off."""

from collections.abc import MutableMapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from sysid.stated import Stated

# Keys and indices that lead to an entry of a campaign: ``("trials", 2, "slope")``.
Place = tuple[str | int, ...]


@dataclass(frozen=True)
class Swap:
    """A likely mistake in writing down a campaign, as what undoes it."""

    # Words for the campaign without the mistake, after "with": ``foot_dx and foot_dz exchanged``.
    title: str
    # Entries to exchange, numbers of the other sign, and numbers with what is added to them.
    exchanged: tuple[tuple[Place, Place], ...] = ()
    negated: tuple[Place, ...] = ()
    moved: tuple[tuple[Place, float], ...] = ()
    # The thing to correct, in words: another one than the campaign if none of its keys is wrong.
    where: str = "the campaign"

    @property
    def keys(self) -> set[str | int]:
        """Last keys of the entries that it changes: ``{"slope"}`` where slopes are exchanged."""
        exchanged = (place for pair in self.exchanged for place in pair)
        places = [*exchanged, *self.negated, *(place for place, _ in self.moved)]
        return {place[-1] for place in places}

    def undone(self, campaign: Any) -> Any:
        """Return a campaign without the mistake."""
        out = campaign
        for one, other in self.exchanged:
            out = _with(out, one, _at(campaign, other))
            out = _with(out, other, _at(campaign, one))
        for place, way in (*((p, -2 * _at(campaign, p)) for p in self.negated), *self.moved):
            number = _at(campaign, place)
            moved = Stated(number + way, number.error, number.assumed) if isinstance(number, Stated) else None
            out = _with(out, place, number + way if moved is None else moved)
        return out

    def undo_in(self, document: MutableMapping[str, Any]) -> None:
        """Undo exchanges and signs in a campaign as it is written."""
        for one, other in self.exchanged:
            nodes = [_parent(document, place) for place in (one, other)]
            # An entry without its comment, which stays where it is.
            written = [node[place[-1]].unwrap() for node, place in zip(nodes, (one, other), strict=True)]
            for node, place, text in zip(nodes, (one, other), reversed(written), strict=True):
                node[place[-1]] = text
        for place in self.negated:
            node = _parent(document, place)
            text = str(node[place[-1]]).strip().removeprefix("+")
            node[place[-1]] = text[1:] if text.startswith("-") else f"-{text}"


def _parent(node: Any, place: Place) -> Any:
    for key in place[:-1]:
        node = node[key]
    return node


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
