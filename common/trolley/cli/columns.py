"""Tables that leave columns out where a terminal is too narrow for all of them."""

import dataclasses
from collections.abc import Sequence

GAP = 2


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table."""

    head: str
    weight: int = 0
    """The lowest is left out first; the first column always stays."""
    is_number: bool = True
    """Numbers stand at the right of their column, words at the left."""


def table_lines(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int
) -> tuple[str, list[str]]:
    """The line of the heads, and a line for each row, none longer than `width`.

    Columns in which nothing stands are left out, too.
    """
    filled = [{row[i] for row in rows} - {"", "-"} for i in range(len(columns))]
    shown = [i for i in range(len(columns)) if i == 0 or filled[i]]
    widths = [
        max(len(cell) for cell in column)
        for column in zip([one.head for one in columns], *rows, strict=True)
    ]
    while len(shown) > 1 and sum(widths[i] + GAP for i in shown) - GAP > width:
        shown.remove(min(shown[1:], key=lambda i: columns[i].weight))
    lines = [
        (" " * GAP).join(_cell(cells[i], widths[i], is_number=columns[i].is_number) for i in shown)
        for cells in ([one.head for one in columns], *rows)
    ]
    cut = [line.rstrip()[:width] for line in lines]
    return cut[0], cut[1:]


def _cell(text: str, width: int, *, is_number: bool) -> str:
    return text.rjust(width) if is_number else text.ljust(width)
