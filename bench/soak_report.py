"""What the soaks' readings say."""

import json
from pathlib import Path
from typing import Any


def read_last_run(path: Path) -> list[dict[str, Any]]:
    """The readings of a run."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def lockstep_figures(readings: list[dict[str, Any]]) -> None:
    print(readings[-1])


def write_page(out: Path) -> None:
    pass
