"""Small pieces of HTML, styled by `frontend/markup.css`; what comes from the wire is escaped.

What is marked with `translate="no"` is a name that people gave; it is so in every language.
"""

import html
import re
from collections.abc import Collection, Sequence

from trolley_viz.words.sentences import StatusLine

_SET_OFF = re.compile("( → | · )")


def row(words: StatusLine, names: Collection[str] = ()) -> str:
    """A coloured dot, the headline, in which there may be names, and the details below it."""
    detail = f"<small>{html.escape(words.detail)}</small>" if words.detail else ""
    return (
        f'<div class="status-row" data-tone="{words.tone}"><i></i>'
        f"<span><b>{_with_names(words.headline, names)}</b>{detail}</span></div>"
    )


def title(text: str) -> str:
    """What all below it is about."""
    return f'<h2 class="title">{html.escape(text)}</h2>'


def heading(text: str) -> str:
    """A line over a group of buttons."""
    return f'<h2 class="heading">{html.escape(text)}</h2>'


def sentence(words: StatusLine) -> str:
    """What a robot is doing, to be read from afar."""
    return (
        f'<div class="sentence" role="status" data-tone="{words.tone}">'
        f"{html.escape(words.headline)}</div>"
    )


def note(text: str) -> str:
    """A line of small print."""
    return f'<div class="note">{html.escape(text)}</div>'


def verbatim(text: str, language: str = "") -> str:
    """A line of small print that stays as it is, such as a value, or one in this language."""
    spoken = f' lang="{html.escape(language)}"' if language else ""
    return f'<div class="note" translate="no"{spoken}>{html.escape(text)}</div>'


def card(name: str, summary: str, names: Collection[str] = ()) -> str:
    """A name and what there is to say about it, in which there may be more names."""
    return (
        f'<div class="card"><b translate="no">{html.escape(name)}</b>'
        f"<small>{_with_names(summary, names)}</small></div>"
    )


def details(words: StatusLine, content: str, names: Collection[str] = ()) -> str:
    """A dot, a headline and its details, which open to more: that is markup already."""
    return (
        f'<details class="details"><summary data-tone="{words.tone}"><i></i> '
        f"<b>{_with_names(words.headline, names)}</b>"
        f"<small>{html.escape(words.detail)}</small></summary>"
        f"{content}</details>"
    )


def _with_names(text: str, names: Collection[str]) -> str:
    """A text whose parts are set off from each other; some of them are names."""
    parts = _SET_OFF.split(text)
    parts[::2] = [_named(part) if part in names else _worded(part) for part in parts[::2]]
    return "".join(parts)


def _named(text: str) -> str:
    return f'<span translate="no">{html.escape(text)}</span>'


def _worded(text: str) -> str:
    return f"<span>{html.escape(text)}</span>"


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
    """A list of names whose entries are numbered; nothing without any."""
    entries = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f'<ol class="numbered" translate="no">{entries}</ol>' if entries else ""


def table(rows: Sequence[tuple[str, ...]], num_names: int = 0) -> str:
    """Rows of cells; the first of each says what the others are about.

    Args:
        rows: the cells.
        num_names: how many of each row, from the first, are names.
    """
    lines = "".join(
        "<tr>" + "".join(_cell(cell, i, num_names) for i, cell in enumerate(cells)) + "</tr>"
        for cells in rows
    )
    return f'<table class="table">{lines}</table>'


def code_image(address: str, what: str) -> str:
    """A QR code, always dark on light, and what it holds in words."""
    return f'<img class="code" src="{html.escape(address)}" alt="{html.escape(what)}">'


def photo(address: str) -> str:
    """A photo, loaded when it comes into view; pressed, it fills a page of its own."""
    where = html.escape(address)
    return (
        f'<a class="photo" href="{where}" target="_blank" rel="noopener" title="Photo of the stop">'
        f'<img src="{where}" loading="lazy" decoding="async" alt=""></a>'
    )


def _cell(text: str, column: int, num_names: int) -> str:
    tag, scope = ("td", "") if column else ("th", ' scope="row"')
    name = ' translate="no"' if column < num_names else ""
    return f"<{tag}{scope}{name}>{html.escape(text)}</{tag}>"


def plot(svg: str) -> str:
    """A picture as wide as the panel."""
    return f'<div class="plot">{svg}</div>'


def swatches(entries: Sequence[tuple[str, tuple[int, int, int]]]) -> str:
    """A legend: squares with their names, which the page's script colours."""
    return "".join(
        f'<div class="swatch"><i data-colour="#{bytes(colour).hex()}"></i>{html.escape(name)}</div>'
        for name, colour in entries
    )
