"""Small pieces of HTML; every text from the wire is escaped here."""

import html
from collections.abc import Sequence

from trolley_viz.sentences import StatusLine, Tone

TONES: dict[Tone, str] = {
    "good": "#1e9e50",
    "busy": "#2f6fe0",
    "warn": "#d98a00",
    "bad": "#d63333",
    "idle": "#808894",
}

_ROW = (
    '<div style="display:flex;gap:0.55em;align-items:flex-start;padding:0.28em 0.8em;'
    'line-height:1.3">'
    '<span style="flex:none;width:0.7em;height:0.7em;border-radius:50%;margin-top:0.32em;'
    'background:{colour}"></span>'
    '<span style="min-width:0;overflow-wrap:anywhere">'
    '<b style="{style}">{headline}</b>{detail}</span>'
    "</div>"
)
_DETAIL = '<br><span style="opacity:0.72;font-size:0.86em">{}</span>'


def row(words: StatusLine) -> str:
    """A coloured dot, the headline, and the details below it."""
    return _ROW.format(
        colour=TONES[words.tone],
        style=f"color:{TONES['bad']}" if words.tone == "bad" else "",
        headline=html.escape(words.headline),
        detail=_DETAIL.format(html.escape(words.detail)) if words.detail else "",
    )


def title(text: str) -> str:
    """A heading."""
    return f'<div style="padding:0.5em 0.8em 0.2em;font-weight:700">{html.escape(text)}</div>'


def sentence(words: StatusLine) -> str:
    """What a robot is doing, to be read from afar."""
    return (
        f'<div role="status" style="margin:0.5em 0.8em 0.3em;padding:0.5em 0.7em;'
        f"border-left:0.3em solid {TONES[words.tone]};border-radius:0.3em;"
        f"background:{TONES[words.tone]}1c;font-size:1.06em;font-weight:600;line-height:1.3;"
        f'overflow-wrap:anywhere">{html.escape(words.headline)}</div>'
    )


def chips(lines: Sequence[StatusLine]) -> str:
    """The headlines in small print, side by side; the details come up under the mouse."""
    pieces = "".join(
        f'<span title="{html.escape(words.detail)}" style="overflow-wrap:anywhere">'
        '<i style="display:inline-block;width:0.65em;height:0.65em;border-radius:50%;'
        f'margin-right:0.4em;background:{TONES[words.tone]}"></i>{html.escape(words.headline)}</span>'
        for words in lines
    )
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:0.1em 1em;padding:0.1em 0.9em 0.8em;'
        f'font-size:0.86em;line-height:1.4">{pieces}</div>'
    )


def note(text: str) -> str:
    """A line of small print."""
    return (
        '<div style="padding:0.2em 0.8em;opacity:0.72;font-size:0.86em;line-height:1.35">'
        f"{html.escape(text)}</div>"
    )


def table(rows: list[tuple[str, ...]]) -> str:
    """Rows of cells; the first of each is strong."""
    lines = "".join(
        "<tr>"
        + "".join(
            f'<td style="padding:0.1em 0.6em 0.1em 0;vertical-align:top">'
            f"{'<b>' if i == 0 else ''}{html.escape(cell)}{'</b>' if i == 0 else ''}</td>"
            for i, cell in enumerate(cells)
        )
        + "</tr>"
        for cells in rows
    )
    return f'<table style="margin:0.2em 0.8em;font-size:0.86em;line-height:1.35">{lines}</table>'


def swatches(entries: list[tuple[str, tuple[int, int, int]]]) -> str:
    """A legend: coloured squares with their names."""
    return "".join(
        '<div style="display:flex;gap:0.5em;align-items:center;padding:0.1em 0.8em;'
        'font-size:0.86em">'
        f'<span style="width:0.8em;height:0.8em;border-radius:0.2em;background:rgb{colour}"></span>'
        f"{html.escape(name)}</div>"
        for name, colour in entries
    )
