"""A report page and its pieces: figures with their text alternative, tables, paragraphs, folded parts.

A notebook shows an `Html` as it is, and the page's template takes it over unchanged. All text is escaped; a
figure is an image inside the page, so nothing is ever fetched.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from urllib.parse import quote

from jinja2 import Environment, PackageLoader
from matplotlib.figure import Figure

import sysid
from sysid.report.drawing import figure_bytes
from sysid.report.table import Table, listed

# Pixels per inch.
_DPI = 130.0
# A vector figure with more bytes than this goes into the page as pixels [bytes].
_LARGEST_VECTOR = 160_000
_PATH, _STEPS = re.compile(r' d="[^"]*"'), re.compile(r"\s*([MLHVCQZz])\s*")
_NUMBERS, _DECIMALS = re.compile(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)'), re.compile(r"(\d+\.\d\d)\d+")
# A cell with more characters is prose, which may be broken [characters].
_LONGEST_CELL = 40
# Characters that need no escape in an address inside double quotes.
_SAFE = " =:;,/()'-."
_PART = re.compile(r'<h2 id="([^"]*)">(.*?)</h2>')


@dataclass(frozen=True)
class Html:
    """Well-formed markup that is safe to show."""

    text: str

    def _repr_html_(self) -> str:
        return self.text

    # jinja2 does not escape what has this method.
    __html__ = _repr_html_

    def __add__(self, other: Html) -> Html:
        return Html(self.text + other.text)


NOTHING = Html("")


def filled(template: str, **content: object) -> Html:
    """Return a template of the folder ``page``, filled in; whatever is not an `Html` is escaped."""
    templates = Environment(loader=PackageLoader("sysid.report", "page"), autoescape=True)
    return Html(templates.get_template(template).render(content))


def page(title: str, body: Html) -> str:
    """Return a page that needs nothing else; its second-level headings become the links above it.

    Its policy lets run the scripts that come with sysid, by their hashes, and no other.
    """
    parts = [(identity, html.unescape(heading)) for identity, heading in _PART.findall(body.text)]
    plots = "data-plot>" in body.text
    scripts = ["page.js", *(("uplot.min.js", "plots.js") if plots else ())]
    for what in ("animation", "cells"):
        scripts += [f"{what}.js"] if f"data-{what}>" in body.text else []
    sources = [_source(name) for name in scripts]
    hashes = [base64.b64encode(sha256(text.encode("utf-8")).digest()).decode("ascii") for text in sources]
    style = (_source("uplot.min.css") if plots else "") + _source("page.css")
    return filled(
        "index.html.j2", title=title, version=sysid.__version__, parts=parts, style=Html(style),
        # A line does not break between a number and its "times".
        body=Html(re.sub(r"(?<=\d) ×", "\N{NO-BREAK SPACE}×", body.text)),
        scripts=[Html(text) for text in sources], policy=" ".join(f"'sha256-{each}'" for each in hashes),
        plots=plots,
    ).text  # fmt: skip


def _source(name: str) -> str:
    return (files("sysid.report") / "page" / name).read_text(encoding="utf-8")


def paragraph(text: str, kind: str = "") -> Html:
    """Return a paragraph of plain text; `kind` is its class."""
    return Html(f"<p{_class(kind)}>{html.escape(text)}</p>")


def heading(text: str, *, linked: bool = True) -> Html:
    """Return a heading with an identity that a link can name, unless none is `linked` to it."""
    if not linked:
        return Html(f"<h2>{html.escape(text)}</h2>")
    identity = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
    return Html(f'<h2 id="{identity}">{html.escape(text)}</h2>')


def preformatted(text: str) -> Html:
    """Return text unchanged; keys scroll it."""
    return Html(f'<pre tabindex="0">{html.escape(text)}</pre>')


def bullets(items: Sequence[str], kind: str = "") -> Html:
    """Return a list of plain texts; nothing without items."""
    if not items:
        return NOTHING
    return Html(f"<ul{_class(kind)}>{''.join(f'<li>{html.escape(item)}</li>' for item in items)}</ul>")


def joined(pieces: Sequence[Html]) -> Html:
    """Return pieces one after the other."""
    return Html("".join(piece.text for piece in pieces))


def side_by_side(pieces: Sequence[Html]) -> Html:
    """Return pieces side by side where the window is wide enough, else below each other."""
    return Html(f'<div class="grid">{joined(pieces).text}</div>') if pieces else NOTHING


def columns(left: Html, right: Html) -> Html:
    """Return two pieces beside each other in a wide window, such as tables and pictures."""
    if not left.text or not right.text:
        return left + right
    return Html(f'<div class="columns"><div>{left.text}</div><div>{right.text}</div></div>')


def in_true_colours(piece: Html) -> Html:
    """Return a piece whose pictures keep their colours on a dark page: they mean what a legend says."""
    return Html(f'<div class="true">{piece.text}</div>')


def unfoldable(summary: str, piece: Html, *, printed: bool = True) -> Html:
    """Return a piece that a reader unfolds; printing shows it where it is `printed`."""
    state = "" if printed else ' class="unprinted"'
    return Html(f"<details{state}><summary>{html.escape(summary)}</summary>{piece.text}</details>")


def picture(figure: Figure, alternative: str, caption: str = "") -> Html:
    """Return a figure as an image inside the page, with a caption below.

    It is drawn as vectors, or as pixels where vectors would be large. The `alternative` says in words what
    the figure shows.
    """
    if not alternative.strip():
        raise ValueError("a figure needs a text alternative")
    width, height = (float(side) for side in figure.get_size_inches())
    svg = _brief(figure_bytes(figure, "svg", _DPI))
    if len(svg) <= _LARGEST_VECTOR:
        source = f"data:image/svg+xml,{quote(svg, safe=_SAFE)}"
    else:
        from PIL import Image

        few_colours = Image.open(io.BytesIO(figure_bytes(figure, "png", _DPI))).convert("RGB").quantize(64)
        buffer = io.BytesIO()
        few_colours.save(buffer, "PNG", optimize=True)
        source = f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
    below = f"<figcaption>{html.escape(caption)}</figcaption>" if caption else ""
    size = f'width="{96 * width:.0f}" height="{96 * height:.0f}"'
    return Html(f'<figure><img src="{source}" alt="{html.escape(alternative)}" {size}>{below}</figure>')


def _brief(svg: bytes) -> str:
    """Return an SVG without what nobody sees: digits below a hundredth of a point, comments, white space."""
    text = svg.decode("utf-8")
    text = _NUMBERS.sub(lambda match: _DECIMALS.sub(r"\1", match.group(0)), text)
    text = _PATH.sub(lambda match: _STEPS.sub(r"\1", match.group(0)), text)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r">\s+<", "><", text)
    return text[text.index("<svg") :].strip().replace('"', "'")


def markup_table(table: Table) -> Html:
    """Return a table with its title above and its caption below, in a box that scrolls where it is narrow."""
    head = "".join(
        f'<th scope="col"{_class("number" if column.number else "")}>{html.escape(column.title)}</th>'
        for column in table.columns
    )
    rows = []
    for row in table.rows:
        cells = [f'<th scope="row"{_class(cell.tone)}>{html.escape(cell.text)}</th>' for cell in row[:1]]
        for cell, column in zip(row[1:], table.columns[1:], strict=True):
            kind = "number" if column.number else "prose" if len(cell.text) > _LONGEST_CELL else ""
            cells.append(f"<td{_class(f'{kind} {cell.tone}'.strip())}>{html.escape(cell.text)}</td>")
        rows.append(f"<tr>{''.join(cells)}</tr>")
    # Above the box that scrolls, not in it: a caption is as wide as its table.
    title = paragraph(table.title, "caption") if table.title else NOTHING
    note = paragraph(table.caption, "note") if table.caption else NOTHING
    return Html(
        f'{title.text}<div class="wide" tabindex="0" role="region" '
        f'aria-label="{html.escape(table.title or "table")}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>{note.text}"
    )


def legend(entries: Sequence[tuple[str, str, str]]) -> Html:
    """Return what colours mean: (colour, ``line``, ``thick``, ``dots``, ``bar`` or ``area``, words) each."""
    items = "".join(
        f'<li><span class="swatch {html.escape(kind)}" style="color: {html.escape(colour)}"></span>'
        f"{html.escape(words)}</li>"
        for colour, kind, words in entries
    )
    return Html(f'<ul class="legend" aria-label="legend of the following figures">{items}</ul>')


def definitions(rows: Sequence[tuple[str, str]], title: str) -> Html:
    """Return a table of two columns: what, and its value."""
    return markup_table(listed(title, rows, ("what", "value"), texts=2))


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
