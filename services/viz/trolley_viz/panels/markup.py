"""Small pieces of HTML; every text from the wire is escaped here."""

import html

from trolley_viz.words import Tone, Words

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


def row(words: Words) -> str:
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
