"""Writing state files in the background: what was superseded while it waited is not written."""

from collections import Counter, defaultdict
from collections.abc import Callable

import msgspec

from trolley.runtime.state import StateFolder

Work = Callable[[Callable[[], object], Callable[[object], None]], None]
Heard = Callable[[OSError | None], None]


class _Superseded:
    """Outcome of a write that left its file to a newer one."""


class Saves:
    """Writes files in the background; of what waits for one file only the newest is written.

    So a service that was told of a thousand zones can end at once, with the last of them saved.

    Args:
        state: the folder of the files.
        work: runs a job on the worker, jobs one after another, then hands its outcome over on the
            service's thread.
    """

    def __init__(self, state: StateFolder, work: Work) -> None:
        self._state = state
        self._work = work
        self._newest: Counter[str] = Counter()
        """Number of saves by file. The service's thread counts, the worker reads."""
        self._waiting: defaultdict[str, list[Heard]] = defaultdict(list)

    def save(self, name: str, value: msgspec.Struct, heard: Heard, *, is_secret: bool) -> None:
        """Write a file, whole or not at all.

        `heard` gets None or an error once this value, or a newer one of the same file, is written.
        """
        self._newest[name] += 1
        number = self._newest[name]

        def write() -> object:
            if self._newest[name] != number:
                return _Superseded()
            try:
                self._state.write(name, value, is_secret=is_secret)
            except OSError as error:
                return error
            return None

        def tell(outcome: object) -> None:
            self._waiting[name].append(heard)
            if isinstance(outcome, _Superseded):
                return
            error = outcome if isinstance(outcome, OSError) else None
            for one in self._waiting.pop(name):
                one(error)

        self._work(write, tell)
