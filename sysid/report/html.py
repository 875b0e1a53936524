"""Pieces of a report page: figures with their text alternative, tables, paragraphs, folded parts.

Every piece is an `Html`, which a notebook shows as it is and the page's template takes over unchanged. All
text is escaped; a figure is an image inside the page, so nothing is ever fetched.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

# A vector figure with more bytes than this goes into the page as pixels [bytes].
_LARGEST_VECTOR = 160_000
_PATH, _STEPS = re.compile(r' d="[^"]*"'), re.compile(r"\s*([MLHVCQZz])\s*")
_NUMBERS, _DECIMALS = re.compile(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)'), re.compile(r"(\d+\.\d\d)\d+")
# A cell with more characters is prose, which may be broken [characters].
_LONGEST_CELL = 40
# What stands for itself in an address inside double quotes.
_SAFE = " =:;,/()'-."


@dataclass(frozen=True)
class Html:
    """Markup that is safe to show.

    Parameters
    ----------
    text : str
        Well-formed HTML.
    """

    text: str

    def _repr_html_(self) -> str:
        return self.text

    def __add__(self, other: Html) -> Html:
        return Html(self.text + other.text)


NOTHING = Html("")


def paragraph(text: str, kind: str = "") -> Html:
    """Return a paragraph of plain text; `kind` is its class."""
    return Html(f"<p{_class(kind)}>{html.escape(text)}</p>")


def heading(text: str, level: int = 3) -> Html:
    """Return a heading."""
    return Html(f"<h{level}>{html.escape(text)}</h{level}>")


def bullets(items: Sequence[str], kind: str = "") -> Html:
    """Return a list of plain texts; nothing without items."""
    if not items:
        return NOTHING
    return Html(f"<ul{_class(kind)}>{''.join(f'<li>{html.escape(item)}</li>' for item in items)}</ul>")


def joined(pieces: Sequence[Html]) -> Html:
    """Return pieces one after the other."""
    return Html("".join(piece.text for piece in pieces))


def grid(pieces: Sequence[Html]) -> Html:
    """Return pieces side by side where the window is wide enough, else below each other."""
    return Html(f'<div class="grid">{joined(pieces).text}</div>') if pieces else NOTHING


def box(piece: Html, kind: str) -> Html:
    """Return a piece in a box of a class."""
    return Html(f"<div{_class(kind)}>{piece.text}</div>")


def folded(summary: str, piece: Html, *, opened: bool = False) -> Html:
    """Return a piece that a reader unfolds; printing shows it."""
    state = " open" if opened else ""
    return Html(f"<details{state}><summary>{html.escape(summary)}</summary>{piece.text}</details>")


def picture(
    figure: Figure, alternative: str, caption: str = "", *, dpi: float = 130.0, vector: bool = True
) -> Html:
    """Return a figure as an image inside the page.

    Parameters
    ----------
    figure : Figure
        Drawn as vectors, or as pixels where those would be large.
    alternative : str
        What the figure shows, in words, for those who do not see it.
    caption : str
        Below the figure.
    dpi : float
        Pixels per inch, where it becomes pixels.
    vector : bool
        False: pixels in any case, for pages with very many figures.
    """
    if not alternative.strip():
        raise ValueError("a figure needs a text alternative")
    width, height = (float(side) for side in figure.get_size_inches())
    svg = _brief(_drawn(figure, "svg", dpi)) if vector else ""
    if vector and len(svg) <= _LARGEST_VECTOR:
        source = f"data:image/svg+xml,{quote(svg, safe=_SAFE)}"
    else:
        pixels = base64.b64encode(_few_colours(_drawn(figure, "png", dpi))).decode("ascii")
        source = f"data:image/png;base64,{pixels}"
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


def _few_colours(png: bytes) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").quantize(64).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _drawn(figure: Figure, kind: str, dpi: float) -> bytes:
    buffer = io.BytesIO()
    metadata = {"Date": None, "Creator": None, "Format": None, "Type": None} if kind == "svg" else {}
    with rc_context({"svg.hashsalt": "sysid"}):
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def markup_table(table: Table) -> Html:
    """Return a terminal's table as one of a page, with its title and caption.

    Parameters
    ----------
    table : rich.table.Table
        Of cells that are plain text.
    """
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    numeric = [column.justify == "right" for column in table.columns]
    head = "".join(
        f'<th scope="col"{_class("number" if numeric[i] else "")}>{html.escape(_plain(column.header))}</th>'
        for i, column in enumerate(table.columns)
    )
    rows = []
    for r in range(len(table.rows)):
        cells = [f'<th scope="row">{html.escape(columns[0][r])}</th>'] if columns else []
        cells += [
            f"<td{_class(_kind(columns[i][r], numeric[i]))}>{html.escape(columns[i][r])}</td>"
            for i in range(1, len(columns))
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    # Above the box that scrolls, not in it: a caption is as wide as its table.
    title = paragraph(_plain(table.title), "caption").text if table.title else ""
    note = f'<p class="note">{html.escape(_plain(table.caption))}</p>' if table.caption else ""
    name = html.escape(_plain(table.title or "table"))
    return Html(
        f'{title}<div class="wide" tabindex="0" role="region" aria-label="{name}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>{note}"
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
    table = Table(title=title)
    table.add_column("what")
    table.add_column("value")
    for what, value in rows:
        table.add_row(Text(what), Text(value))
    return markup_table(table)


def _plain(cell: object) -> str:
    return cell.plain if isinstance(cell, Text) else str(cell)


def _kind(cell: str, numeric: bool) -> str:
    if numeric:
        return "number"
    return "prose" if len(cell) > _LONGEST_CELL else ""


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
