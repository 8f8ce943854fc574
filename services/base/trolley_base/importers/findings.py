"""What is gathered from another system's files."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from trolley.config.describe import to_toml


class Value(NamedTuple):
    """Something that a file says, and where."""

    value: Any
    file: Path
    line: int

    @property
    def number(self) -> float | None:
        """It as a finite number, None for anything else."""
        try:
            number = float(self.value)
        except (TypeError, ValueError):
            return None
        return number if math.isfinite(number) else None


@dataclass(slots=True)
class Findings:
    """What was found.

    Attributes:
        folder: where the files lie.
        chosen: settings as `section.key`, their values as TOML writes them.
        taken: what was taken in words, and from which file and line.
        left: what was not taken, and why.
        notes: what was not found and what holds instead, and what is to be known; sentences.
        map_file: the map's YAML file; None without a usable map.
    """

    folder: Path
    chosen: dict[str, str] = field(default_factory=dict[str, str])
    taken: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    left: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    notes: list[str] = field(default_factory=list[str])
    map_file: Path | None = None

    def set(self, key: str, value: Any) -> None:
        """Choose a setting that follows from others."""
        self.chosen[key] = to_toml(value)

    def take(self, key: str, value: Any, words: str, *sources: Value) -> None:
        """Choose a setting, and remember from where it is."""
        self.set(key, value)
        lines: dict[Path, list[int]] = {}
        for source in sources:
            lines.setdefault(source.file, []).append(source.line)
        places = [f"{shown(file, self.folder)}:{_span(some)}" for file, some in lines.items()]
        self.taken.append((words, ", ".join(places)))

    def note(self, text: str) -> None:
        """Remember a sentence for the person."""
        self.notes.append(text)

    def place(self, value: Value) -> str:
        """Say where something stands: file and line."""
        return f"{shown(value.file, self.folder)}:{value.line}"


def _span(lines: list[int]) -> str:
    """Lines for people: one, or the first and the last."""
    low, high = min(lines), max(lines)
    return f"{low}" if low == high else f"{low}-{high}"


def shown(path: Path, folder: Path) -> str:
    """A file's name for people: from the folder if it lies there."""
    try:
        return str(path.relative_to(folder))
    except ValueError:
        return str(path)
