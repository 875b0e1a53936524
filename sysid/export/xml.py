"""XML documents that other simulators read, with comments for people."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from xml.etree.ElementTree import Element

from sysid.errors import ExportError


def add(parent: Element, tag: str, text: object = None, **attributes: object) -> Element:
    """Append an element with attributes and text; numbers read back to equal values."""
    child = ElementTree.SubElement(parent, tag, {key: written(value) for key, value in attributes.items()})
    child.text = None if text is None else written(text)
    return child


def comment(parent: Element, text: str) -> None:
    """Append a comment."""
    parent.append(ElementTree.Comment(f" {text.replace('--', '-')} "))


def written(value: object) -> str:
    """Return a word, a number, or numbers separated by spaces, as text."""
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return " ".join(written(entry) for entry in value)
    return repr(value) if isinstance(value, int) else repr(float(value))  # type: ignore[arg-type]


def document(root: Element) -> bytes:
    """Return the file of an element tree."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def parse(data: bytes, what: str) -> Element:
    """Return the root of a file; ExportError when it is no XML."""
    try:
        return ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise ExportError(f"not {what} ({error}); give a file that sysid export wrote") from error
