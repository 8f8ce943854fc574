"""Results in a file, one a line, so that a long bench can be run in slices."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

Result = dict[str, Any]


class Slices:
    """Runs what the file does not hold yet, until its time is over.

    Args:
        file: JSON Lines, appended to; None: nothing is kept.
        minutes: after so long nothing more is begun [min].
    """

    def __init__(self, file: Path | None, minutes: float) -> None:
        self._file = file
        self._end_s = time.monotonic() + 60.0 * minutes
        lines = file.read_text().splitlines() if file is not None and file.exists() else []
        self._old = [json.loads(line) for line in lines]
        self.results: list[Result] = []
        """Of all that was asked for, those of earlier runs included."""
        self.left = 0
        """How many were asked for when the time was over."""

    def having(self, name: str) -> list[Result]:
        """The results with such an entry."""
        return [one for one in self.results if name in one]

    def run(self, key: Result, work: Callable[[], Result]) -> None:
        """Do a piece of work that a key names, or take its result from the file."""
        known = [one for one in self._old if one | key == one]
        if known:
            self.results.append(known[-1])
        elif time.monotonic() > self._end_s:
            self.left += 1
        else:
            began_s = time.process_time()
            result = key | work() | {"cpu_s": round(time.process_time() - began_s, 1)}
            self.results.append(result)
            line = json.dumps(result, ensure_ascii=False)
            print(line, flush=True)
            if self._file is not None:
                self._file.parent.mkdir(parents=True, exist_ok=True)
                with self._file.open("a") as out:
                    out.write(line + "\n")
