"""How results are printed: JSON, poses, tables, and a line that is rewritten as time passes."""

import json
import math
import shutil
import sys
import time
from collections.abc import Sequence
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.cli.printing import can_say, say, say_block, say_over
from trolley.geometry import Pose2D
from trolley.messages.arrays import arrays_of
from trolley.runtime.codec import to_plain
from trolley.sanitize import escape

SHORTEN_TO = 8
QUIET_PERIOD_S = 5.0
NARROWEST = 20


def as_json(value: Any, *, indent: int | None = 2) -> str:
    """A message, or plain values that hold messages, as JSON for a program."""
    text = json.dumps(_plain(value), indent=indent, ensure_ascii=False)
    if not can_say(text):
        return json.dumps(_plain(value), indent=indent)
    if text.replace("\n", "").isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text)


def print_json(value: Any) -> None:
    """Print a value as JSON."""
    say_block(as_json(value))


def _plain(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        plain = to_plain(value)
        for field, array in arrays_of(value).items():
            plain[field] = _numbers(array)
        return plain
    if isinstance(value, dict):
        items = cast("dict[Any, Any]", value)
        return {str(key): _plain(item) for key, item in items.items()}
    if isinstance(value, list | tuple):  # pyrefly: ignore[implicit-any-type-argument]
        return [_plain(item) for item in cast("Sequence[Any]", value)]
    return value


def _numbers(array: NDArray[Any]) -> Any:
    """An array as nested lists; what is not finite is null, since JSON has no word for it."""
    if array.dtype.kind != "f":
        return array.tolist()
    rounded = np.round(array.astype(np.float64), 6)
    numbers = rounded.astype(object)
    numbers[~np.isfinite(rounded)] = None
    return numbers.tolist()


def describe(message: msgspec.Struct, *, full: bool = False) -> str:
    """A message as `field: value` lines; arrays as numbers, shortened unless `full`."""
    arrays = arrays_of(message)
    lines: list[str] = []
    for field in msgspec.structs.fields(message):
        if field.name in arrays:
            text = _array_text(arrays[field.name], full=full)
        else:
            text = _value_text(getattr(message, field.name))
        lines.append(f"{field.name}: {text}")
    return "\n".join(lines)


def _array_text(array: NDArray[Any], *, full: bool) -> str:
    shape = " x ".join(map(str, array.shape))
    with np.printoptions(
        precision=3,
        suppress=True,
        threshold=sys.maxsize if full else SHORTEN_TO,
        edgeitems=SHORTEN_TO // 2,
        linewidth=sys.maxsize if array.ndim == 1 else 120,
    ):
        numbers = str(array)
    return f"({shape} {array.dtype.name}) {numbers}"


def _value_text(value: Any) -> str:
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Pose2D):
        return pose_text(value)
    plain: Any = _plain(value)
    return escape(plain) if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)


def pose_text(pose: Pose2D) -> str:
    """A pose for a person, the heading in both units."""
    yaw = f"{pose.yaw:.3f} rad ({math.degrees(pose.yaw):.0f}°)"
    return f"x {pose.x:.3f} m, y {pose.y:.3f} m, yaw {yaw}"


def counted(number: int, noun: str) -> str:
    """A number of things for a person, the noun in the plural where it is not one."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def seconds_text(seconds: float | None) -> str:
    """A duration for a person."""
    if seconds is None:
        return "?"
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return (
        f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
    )


def print_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print columns as wide as they need to be; nothing but the heads if there are no rows."""
    lines = [[escape(text) for text in row] for row in (heads, *rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for index, row in enumerate(lines):
        cells = zip(row, widths, strict=True)
        say("  ".join(text.ljust(width) for text, width in cells).rstrip(), bold=index == 0)


class Progress:
    """One line that says how far something is: rewritten in a terminal, else a line now and then.

    It goes to stderr, so what a command prints can be piped.
    """

    def __init__(self) -> None:
        self._live = sys.stderr.isatty()
        self._length = 0
        self._kind: str | None = None
        self._text = ""
        self._printed_s = -math.inf

    def show(self, text: str, kind: str = "") -> None:
        """Show `text`; without a terminal when `kind` changes, and if it is new every 5 s."""
        if self._live:
            width = max(NARROWEST, shutil.get_terminal_size().columns - 1)
            line = escape(text)[:width]
            say_over(line.ljust(self._length))
            self._length = len(line)
            return
        now_s = time.monotonic()
        is_due = text != self._text and now_s - self._printed_s >= QUIET_PERIOD_S
        if kind != self._kind or is_due:
            say(text, err=True)
            self._kind, self._text, self._printed_s = kind, text, now_s

    def clear(self) -> None:
        """Take the line away, so that something else can be printed."""
        if self._length:
            say_over(" " * self._length)
            say_over("")
            self._length = 0
