"""Drops in motion inside a page: numbers and a small script that draws them; nothing is fetched."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Sequence
from importlib import resources

from sysid.report.drop_replay import DropReplay, animation_data
from sysid.report.html import Html


def animation(drops: Sequence[DropReplay], campaigns: Sequence[str] = ()) -> Html:
    """Return drops to be played, stepped through and slowed down; `campaigns` tells drops of several apart.

    Nothing moves until a reader asks for it; where a reader's system asks for reduced motion, playing steps
    from one instant of Fig. 7 to the next.
    """
    documents = animation_data(list(drops))
    words = [
        f"{drop.name}: {math.degrees(drop.slope):.0f}°, {document['use']}"
        for drop, document in zip(drops, documents["drops"], strict=True)
    ]
    if campaigns:
        words = [f"{campaign}, {word}" for campaign, word in zip(campaigns, words, strict=True)]
    # A page ends a script at the first "</script"; JSON may hold "<" as an escape.
    data = json.dumps(documents, separators=(",", ":")).replace("<", "\\u003c")
    choices = "".join(f'<option value="{i}">{html.escape(word)}</option>' for i, word in enumerate(words))
    steepest = max(range(len(drops)), key=lambda i: drops[i].slope)
    choices = choices.replace(f'value="{steepest}"', f'value="{steepest}" selected')
    names = ", ".join(drop.name for drop in drops)
    script = resources.files("sysid.report").joinpath("page", "animation.js").read_text(encoding="utf-8")
    return Html(
        '<div class="animation">'
        '<canvas role="img" aria-label="Side view of the drone landing on the slope: simulated body and legs '
        "with the normal force (blue) and the friction (red) of each foot, and the measured body as a grey "
        f'outline. Drops: {html.escape(names)}.">The drop needs a browser with canvas.</canvas>'
        '<div class="controls">'
        '<button type="button" data-do="play">Play</button>'
        '<label class="time">time <input type="range" min="0" max="100" step="1" value="0" data-do="seek">'
        '</label><output data-do="clock">0 ms</output>'
        '<label>speed <select data-do="speed"><option value="1">real time</option>'
        '<option value="10" selected>10 × slow</option><option value="50">50 × slow</option></select></label>'
        f'<label>drop <select data-do="drop">{choices}</select></label>'
        '<label><input type="checkbox" checked data-do="ghost"> measured</label>'
        '<span class="instants" data-do="instants"></span>'
        "</div>"
        '<p class="note"><span class="key normal">normal force</span> <span class="key friction">friction'
        '</span> <span class="key ghost">measured body</span>; legs as they deflect, dashed: at rest.</p>'
        f'<script type="application/json">{data}</script>'
        f"<script>{script}</script>"
        "</div>"
    )
