"""Figures beside their targets, as the programs in this folder print them."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Figure:
    """One measured figure."""

    what: str
    now: str
    target: str = ""
    """Its target; empty if it is only for comparison."""
    is_met: bool | None = None


def at_most(what: str, value: float, limit: float, unit: str = "", digits: int = 3) -> Figure:
    """A figure that must not exceed its target."""
    return _compared(what, value, f"≤ {limit:g}", value <= limit, (unit, digits))


def at_least(what: str, value: float, limit: float, unit: str = "", digits: int = 3) -> Figure:
    """A figure that must reach its target."""
    return _compared(what, value, f"≥ {limit:g}", value >= limit, (unit, digits))


def _compared(what: str, value: float, target: str, is_met: bool, form: tuple[str, int]) -> Figure:
    unit, digits = form
    return Figure(what, f"{value:.{digits}f} {unit}".rstrip(), f"{target} {unit}".rstrip(), is_met)


def show(figures: Sequence[Figure]) -> None:
    """Print figures as a table: what, now, target, whether it is met."""
    width = max((len(one.what) for one in figures), default=0)
    for one in figures:
        verdict = {None: "", True: "met", False: "MISSED"}[one.is_met]
        print(f"{one.what:{width}}  {one.now:>16}  {one.target:>14}  {verdict}".rstrip())
    print(flush=True)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows of cells below their heads, the first column to the left."""
    lines = [heads, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(heads))]
    for line in lines:
        cells = [f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)]
        print("  ".join([f"{line[0]:{widths[0]}}", *cells[1:]]))
    print(flush=True)


def recordings_folder() -> Path | None:
    """The folder that TROLLEY_DATA names; None, and a line that says so, where it names none."""
    folder = os.environ.get("TROLLEY_DATA")
    if folder is None:
        print("skipped: TROLLEY_DATA does not name the folder of the recordings")
        return None
    return Path(folder)


def wilson_upper(hits: int, count: int, z: float = 1.645) -> float:
    """Return the one-sided upper bound (Wilson score) of a share of which `hits` were seen.

    Args:
        hits: of `count`.
        count: 0 says nothing: the bound is 1.
        z: quantile of the normal distribution; 1.645 is 95 % confidence.
    """
    if count == 0:
        return 1.0
    share = hits / count
    middle = share + z * z / (2.0 * count)
    half = z * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
    return (middle + half) / (1.0 + z * z / count)
