"""One page that needs nothing else: the template filled with pieces, styles and scripts inside."""

from __future__ import annotations

import html
import re
from importlib import resources

from jinja2 import Environment, PackageLoader

import sysid
from sysid.report.html import Html

_PART = re.compile(r'<h2 id="([^"]*)">(.*?)</h2>')


def page(title: str, body: Html) -> str:
    """Return a page of HTML; its second-level headings become the links above it."""
    # Whatever is not an `Html` is escaped.
    templates = Environment(loader=PackageLoader("sysid.report", "page"), autoescape=True)
    style = resources.files("sysid.report").joinpath("page", "page.css").read_text(encoding="utf-8")
    parts = [(identity, html.unescape(heading)) for identity, heading in _PART.findall(body.text)]
    return templates.get_template("index.html.j2").render(
        title=title, version=sysid.__version__, style=Html(style), parts=parts, body=body
    )
