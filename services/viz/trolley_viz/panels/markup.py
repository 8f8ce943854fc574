"""Small pieces of HTML, styled by `frontend/markup.css`; what comes from the wire is escaped."""

import html
from collections.abc import Sequence

from trolley_viz.sentences import StatusLine


def row(words: StatusLine) -> str:
    """A coloured dot, the headline, and the details below it."""
    detail = f"<small>{html.escape(words.detail)}</small>" if words.detail else ""
    return (
        f'<div class="status-row" data-tone="{words.tone}"><i></i>'
        f"<span><b>{html.escape(words.headline)}</b>{detail}</span></div>"
    )


def title(text: str) -> str:
    """What all below it is about."""
    return f'<div class="title">{html.escape(text)}</div>'


def heading(text: str) -> str:
    """A line over a group of buttons."""
    return f'<div class="heading">{html.escape(text)}</div>'


def sentence(words: StatusLine) -> str:
    """What a robot is doing, to be read from afar."""
    return (
        f'<div class="sentence" role="status" data-tone="{words.tone}">'
        f"{html.escape(words.headline)}</div>"
    )


def note(text: str) -> str:
    """A line of small print."""
    return f'<div class="note">{html.escape(text)}</div>'


def card(name: str, summary: str) -> str:
    """A name and what there is to say about it."""
    return (
        f'<div class="card"><b>{html.escape(name)}</b><small>{html.escape(summary)}</small></div>'
    )


def details(words: StatusLine, content: str) -> str:
    """A dot, a headline and its details, which open to more: that is markup already."""
    return (
        f'<details class="details"><summary data-tone="{words.tone}"><i></i> '
        f"<b>{html.escape(words.headline)}</b><small>{html.escape(words.detail)}</small></summary>"
        f"{content}</details>"
    )


def lead(press: str, text: str) -> str:
    """A small button; its control hears `press`."""
    return (
        f'<button type="button" class="small" data-press="{html.escape(press)}">'
        f"{html.escape(text)}</button>"
    )


def leads(entries: Sequence[tuple[str, StatusLine]]) -> str:
    """Lines that can be pressed, each with what its control hears then."""
    buttons = "".join(
        f'<button type="button" class="lead" data-press="{html.escape(press)}"'
        f' data-tone="{words.tone}"><i></i><span><b>{html.escape(words.headline)}</b>'
        f"{html.escape(words.detail)}</span></button>"
        for press, words in entries
    )
    return f'<div class="leads">{buttons}</div>' if buttons else ""


def numbered(texts: Sequence[str]) -> str:
    """A list whose entries are numbered; nothing without any."""
    entries = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f'<ol class="numbered">{entries}</ol>' if entries else ""


def table(rows: Sequence[tuple[str, ...]]) -> str:
    """Rows of cells; the first of each says what the others are about."""
    lines = "".join(
        f'<tr><th scope="row">{html.escape(first)}</th>'
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for first, *cells in rows
    )
    return f'<table class="table">{lines}</table>'


def plot(svg: str) -> str:
    """A picture as wide as the panel."""
    return f'<div class="plot">{svg}</div>'


def swatches(entries: Sequence[tuple[str, tuple[int, int, int]]]) -> str:
    """A legend: squares with their names, which the page's script colours."""
    return "".join(
        f'<div class="swatch"><i data-colour="#{bytes(colour).hex()}"></i>{html.escape(name)}</div>'
        for name, colour in entries
    )
