"""What an overlay looks like in the page just now: a card of HTML that is safe to put there."""

import math
from dataclasses import dataclass

from msgspec import Struct

from trolley.messages import Overlay, OverlayRule
from trolley_viz.overlays.figures import gauge_svg, number, plot_columns, plot_svg
from trolley_viz.overlays.markup import css_colour, escaped, safe_markup
from trolley_viz.overlays.readings import Reading
from trolley_viz.overlays.rules import first_match
from trolley_viz.overlays.source import FrameSource, Value

PLACES = (
    "top-left",
    "top",
    "top-right",
    "left",
    "right",
    "bottom-left",
    "bottom",
    "bottom-right",
)
"""Where an overlay may lie; anything else is the first of them."""
DEFAULT_PX, MIN_PX, MAX_PX = 14.0, 8.0, 48.0
"""Size of the text."""
MAX_ITEMS = 40
WINDOW_S = 60.0
"""How far back a plot reaches; its CSV holds all that is kept."""
DEGREES = ("deg", "degrees", "°")
SIGNS = ("°", "%")
"""Units that stand close to their number."""


class Card(Struct, frozen=True):
    """One overlay, as the page gets it."""

    kind: str
    place: str
    style: str
    head: str
    """HTML that rarely changes: the title, and the button for the CSV."""
    body: str
    """HTML."""


@dataclass(frozen=True)
class CardContext:
    """What the card of an overlay depends on besides the overlay: the time, and what is silent."""

    now_ns: int
    """Local monotonic time."""
    is_away: bool = False
    """The robot's clock is silent."""
    silent: frozenset[str] = frozenset()
    """The services that are not running."""


def card_of(
    overlay: Overlay, reading: Reading | None, chosen: int | None, when: CardContext
) -> Card:
    """Make the card of an overlay.

    Args:
        overlay: what a program asked for.
        reading: of its source, None where it has none.
        chosen: the item of a menu that was clicked last.
        when: the moment.
    """
    rule = _rule(overlay, reading)
    body = {"text": _text, "gauge": _gauge, "plot": _plot}
    if overlay.kind == "menu":
        content = _menu(overlay, reading, rule, chosen)
    else:
        content = body[overlay.kind](overlay, reading, rule, when)
    size = DEFAULT_PX if not overlay.size else min(max(overlay.size, MIN_PX), MAX_PX)
    colour = overlay.color if rule is None or rule.color is None else rule.color
    return Card(
        kind=overlay.kind,
        place=overlay.place if overlay.place in PLACES else PLACES[0],
        style=f"color:{css_colour(colour)};background:{css_colour(overlay.background)};"
        f"font-size:{size:g}px",
        head=_head(overlay),
        body=content + _trouble(reading, when),
    )


def item_of(overlay: Overlay, reading: Reading | None) -> int | None:
    """The item of a menu that is marked: by rule, by the source's word or number, or as asked."""
    rule = _rule(overlay, reading)
    if rule is not None and rule.text in overlay.items:
        return overlay.items.index(rule.text)
    value = None if reading is None else reading.value
    if isinstance(value, str) and value in overlay.items:
        return overlay.items.index(value)
    if isinstance(value, float) and not overlay.rules and value.is_integer():
        return int(value)
    return overlay.index


def scale_of(overlay: Overlay, reading: Reading | None) -> float:
    """What a value is multiplied with to be shown: bearings may be asked for in degrees."""
    source = None if reading is None else reading.source
    is_bearing = isinstance(source, FrameSource) and source.what == "bearing"
    return math.degrees(1.0) if is_bearing and overlay.unit in DEGREES else 1.0


def written(value: Value, unit: str, scale: float = 1.0) -> str:
    """Write a value for people, with its unit; a dash where nothing is known."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    return f"{number(value * scale)}{unit if unit in SIGNS else f' {unit}' if unit else ''}"


def _rule(overlay: Overlay, reading: Reading | None) -> OverlayRule | None:
    found = None if reading is None else reading.relation
    distance, bearing = (None, None) if found is None else (found.distance, found.bearing)
    return first_match(overlay.rules, distance, bearing)


def _head(overlay: Overlay) -> str:
    title = f'<div class="ov-title">{escaped(overlay.title, 80)}</div>' if overlay.title else ""
    if overlay.kind != "plot":
        return title
    button = '<button type="button" class="ov-csv" title="Save as CSV" translate="yes">CSV</button>'
    return f'<div class="ov-row">{title or "<span></span>"}{button}</div>'


def _text(
    overlay: Overlay, reading: Reading | None, rule: OverlayRule | None, _: CardContext
) -> str:
    text = overlay.text if rule is None or not rule.text else rule.text
    if reading is None:
        return f'<div class="ov-text">{safe_markup(text)}</div>'
    scale, found = scale_of(overlay, reading), reading.relation
    value = escaped(written(reading.value, overlay.unit, scale))
    known = {
        "{value}": value,
        "{distance}": "–" if found is None else f"{number(found.distance)} m",
        "{bearing}": "–" if found is None else f"{number(math.degrees(found.bearing))}°",
    }
    filled = safe_markup(text) or "{value}"
    for name, what in known.items():
        filled = filled.replace(name, what)
    return f'<div class="ov-text">{filled}</div>'


def _menu(
    overlay: Overlay, reading: Reading | None, rule: OverlayRule | None, chosen: int | None
) -> str:
    marked = item_of(overlay, reading)
    if marked is None and not overlay.source:
        marked = chosen
    items = "".join(
        f'<button type="button" class="ov-item" data-index="{i}" '
        f'aria-pressed="{"true" if i == marked else "false"}">{escaped(item, 80)}</button>'
        for i, item in enumerate(overlay.items[:MAX_ITEMS])
    )
    more = len(overlay.items) - MAX_ITEMS
    note = _note(f"{more} more are not shown.") if more > 0 else ""
    word = rule.text if rule is not None and rule.text not in overlay.items else ""
    text = safe_markup(word or overlay.text)
    return (f'<div class="ov-text">{text}</div>' if text else "") + items + note


def _gauge(
    overlay: Overlay, reading: Reading | None, rule: OverlayRule | None, when: CardContext
) -> str:
    scale = scale_of(overlay, reading)
    value = None if reading is None or isinstance(reading.value, str) else reading.value
    shown = None if value is None else value * scale
    low, high = _bounds(overlay, shown)
    sign = overlay.unit if overlay.unit in SIGNS else ""
    text = "–" if shown is None else number(shown) + sign
    return gauge_svg(shown, low, high, text, "" if sign else overlay.unit) + _caption(overlay, rule)


def _plot(
    overlay: Overlay, reading: Reading | None, rule: OverlayRule | None, when: CardContext
) -> str:
    scale = scale_of(overlay, reading)
    if reading is None or (reading.problem and not len(reading.history)):
        return ""
    lines = reading.history.lines(when.now_ns, WINDOW_S, plot_columns())
    scaled = [(times, values * scale) for times, values in lines]
    value = written(reading.value, overlay.unit, scale)
    svg = plot_svg(scaled, WINDOW_S, overlay.min, overlay.max)
    return f'<div class="ov-value">{escaped(value)}</div>{svg}{_caption(overlay, rule)}'


def _bounds(overlay: Overlay, value: float | None) -> tuple[float, float]:
    """The ends of a dial; what is not said is as far as zero and the value need."""
    seen = value or 0.0
    low = min(0.0, seen) if overlay.min is None else overlay.min
    high = max(1.0, seen) if overlay.max is None else overlay.max
    return (low, high) if high > low else (low, low + 1.0)


def _caption(overlay: Overlay, rule: OverlayRule | None) -> str:
    text = safe_markup(overlay.text if rule is None or not rule.text else rule.text)
    return f'<div class="ov-text ov-caption">{text}</div>' if text else ""


def _trouble(reading: Reading | None, when: CardContext) -> str:
    """Why there is no value, or how long there has been none."""
    if reading is None:
        return ""
    if reading.problem:
        return _note(reading.problem, " data-trouble")
    age_s = reading.age_s(when.now_ns)
    if age_s is None:
        return _note("No data yet.", " data-trouble")
    if reading.is_silent(when.now_ns, when.silent, is_away=when.is_away):
        return _note(f"No data for {age_s:.0f} s.", " data-trouble")
    return ""


def _note(text: str, mark: str = "") -> str:
    """A line of our own words between those of a program."""
    return f'<div class="ov-note"{mark} translate="yes">{escaped(text, 600)}</div>'
