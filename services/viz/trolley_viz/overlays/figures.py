"""Gauges and plots as SVG. Every text in them is escaped; the colour is that of the text around."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from trolley_viz.overlays.markup import escaped

Line = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times [s], 0 now and negative before, and values."""

PLOT_WIDTH, PLOT_HEIGHT = 260, 104
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 6, 8, 18
_SWEEP = math.radians(240.0)
_RADIUS = 42.0


def plot_columns() -> int:
    """How many pixels wide the line of a plot is drawn."""
    return PLOT_WIDTH - _LEFT - _RIGHT


def gauge_svg(value: float | None, low: float, high: float, text: str, unit: str) -> str:
    """Draw a dial from `low` to `high`, filled from zero (or the end next to it) to the value."""
    span = high - low if high > low else 1.0
    share = 0.0 if value is None else min(max((value - low) / span, 0.0), 1.0)
    zero = min(max((0.0 - low) / span, 0.0), 1.0)
    filled = "" if value is None else _arc(min(zero, share), max(zero, share), 1.0)
    return (
        '<svg class="ov-gauge" viewBox="0 0 120 92" role="img" '
        f'aria-label="{escaped(text)} {escaped(unit)}">'
        f"{_arc(0.0, 1.0, 0.22)}{filled}"
        f'<text x="60" y="58" text-anchor="middle" class="ov-big">{escaped(text, 12)}</text>'
        f'<text x="60" y="72" text-anchor="middle" class="ov-small">{escaped(unit, 16)}</text>'
        f'<text x="22" y="88" text-anchor="middle" class="ov-small">{number(low)}</text>'
        f'<text x="98" y="88" text-anchor="middle" class="ov-small">{number(high)}</text></svg>'
    )


def plot_svg(
    lines: Sequence[Line],
    window_s: float,
    low: float | None = None,
    high: float | None = None,
    colour: str = "currentColor",
) -> str:
    """Draw lines over the last seconds, with a grid; a missing bound follows the values."""
    bottom, top = value_range(lines, low, high)
    right, base = PLOT_WIDTH - _RIGHT, PLOT_HEIGHT - _BOTTOM

    def y_of(value: float) -> float:
        return base - (value - bottom) / (top - bottom) * (base - _TOP)

    grid = "".join(
        f'<line x1="{_LEFT}" x2="{right}" y1="{y_of(value):.1f}" y2="{y_of(value):.1f}" '
        'class="ov-grid"/>'
        f'<text x="{_LEFT - 4}" y="{y_of(value) + 3.5:.1f}" text-anchor="end" '
        f'class="ov-small">{tick}</text>'
        for value, tick in ticks(bottom, top)
    )
    scale = (right - _LEFT) / window_s
    drawn = "".join(_polyline(right + t * scale, v, y_of, colour) for t, v in lines)
    return (
        f'<svg class="ov-plot" viewBox="0 0 {PLOT_WIDTH} {PLOT_HEIGHT}" role="img">{grid}'
        f'<svg x="0" y="{_TOP - 2}" width="{PLOT_WIDTH}" height="{base - _TOP + 4}" '
        f'viewBox="0 {_TOP - 2} {PLOT_WIDTH} {base - _TOP + 4}">{drawn}</svg>'
        f'<text x="{_LEFT}" y="{PLOT_HEIGHT - 5}" class="ov-small" translate="yes">'
        f"{_span(window_s)} ago</text>"
        f'<text x="{right}" y="{PLOT_HEIGHT - 5}" text-anchor="end" class="ov-small" '
        'translate="yes">now</text>'
        "</svg>"
    )


def value_range(
    lines: Sequence[Line], low: float | None = None, high: float | None = None
) -> tuple[float, float]:
    """The range to draw: what is fixed, else a little more than what the lines reach."""
    least = min((float(v.min()) for _, v in lines), default=0.0)
    most = max((float(v.max()) for _, v in lines), default=1.0)
    # In halves, since the difference of two huge numbers may not be a number.
    is_flat = 0.5 * most - 0.5 * least <= 1e-9 * max(abs(most), 1.0)
    margin = 0.05 * max(abs(most), 1.0) if is_flat else 0.1 * (0.5 * most - 0.5 * least)
    bottom = least - margin if low is None else low
    top = most + margin if high is None else high
    if not top > bottom:
        bottom, top = (bottom, bottom + 1.0) if high is None else (top - 1.0, top)
    if not (math.isfinite(top - bottom) and top > bottom):
        return -1.0, 1.0
    return bottom, top


def ticks(low: float, high: float, most: int = 5) -> list[tuple[float, str]]:
    """Round numbers between two bounds, at most `most` of them, and how they are written."""
    raw = (high - low) / (most - 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw)
    first = math.ceil(low / step)
    inside = [(first + i) * step for i in range(most)]
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    is_plain = digits <= 4 and max(abs(low), abs(high)) < 1e6
    return [
        (value, f"{value + 0.0:.{digits}f}" if is_plain else f"{value:.3g}")
        for value in inside
        if value <= high + 1e-9 * step
    ]


def number(value: float) -> str:
    """Write a number in few characters."""
    size = abs(value)
    if size >= 1e5 or 0.0 < size < 1e-3:
        return f"{value:.2g}"
    digits = 0 if size >= 100 else 1 if size >= 10 else 2
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def _arc(start: float, end: float, opacity: float) -> str:
    """A piece of the dial, from one share of its sweep to another."""
    if end - start < 1e-3:
        end = start + 1e-3
    points = [
        f"{60 - _RADIUS * math.sin(angle):.2f} {54 - _RADIUS * math.cos(angle):.2f}"
        for angle in (_SWEEP * (0.5 - share) for share in (start, end))
    ]
    large = 1 if (end - start) * _SWEEP > math.pi else 0
    return (
        f'<path d="M {points[0]} A {_RADIUS} {_RADIUS} 0 {large} 1 {points[1]}" '
        f'fill="none" stroke="currentColor" stroke-width="9" opacity="{opacity}"/>'
    )


def _polyline(
    x: NDArray[np.float64],
    values: NDArray[np.float64],
    y_of: Callable[[float], float],
    colour: str,
) -> str:
    if len(x) == 1:
        return f'<circle cx="{x[0]:.1f}" cy="{y_of(values[0]):.1f}" r="1.6" fill="{colour}"/>'
    # Kept within what a browser can draw, however far off the fixed range a value lies.
    points = " ".join(
        f"{at:.1f},{min(max(y_of(value), -1e4), 1e4):.1f}"
        for at, value in zip(x.tolist(), values.tolist(), strict=True)
    )
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"/>'


def _span(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
