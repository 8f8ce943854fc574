"""The stop latch: whether somebody stopped the robot, and that the disk holds the same."""

from collections.abc import Callable

Then = Callable[[], None]


class Latch:
    """Keeps the newest value on disk with one write at a time, so that no flood makes a queue.

    Args:
        write: Begins to write a value, and calls back with whether the disk holds it now.
    """

    def __init__(self, write: Callable[[bool, Callable[[bool], None]], None]) -> None:
        self.is_set = False
        self._write = write
        self._saved: bool | None = False
        """What the disk holds; None where that is not known."""
        self._is_writing = False
        self._waiting: list[Then] = []

    def begin(self, *, is_set: bool, is_saved: bool) -> None:
        """Start with what was found on disk, or with what has to be assumed."""
        self.is_set = is_set
        self._saved = is_set if is_saved else None

    def set(self, *, is_set: bool, then: Then | None = None) -> None:
        """Take a value; `then` is called once the disk holds it or what came after it, or fails."""
        self.is_set = is_set
        if self._saved == is_set and not self._is_writing:
            if then is not None:
                then()
            return
        if then is not None:
            self._waiting.append(then)
        self.save()

    def save(self) -> None:
        """Write what the disk does not hold yet, also after it had no room."""
        if self._is_writing or self._saved == self.is_set:
            return
        value, served, self._waiting = self.is_set, self._waiting, []
        self._is_writing = True

        def written(is_saved: bool) -> None:
            self._is_writing = False
            self._saved = value if is_saved else None
            for then in served:
                then()
            if self._waiting or (is_saved and self.is_set != value):
                self._continue()

        self._write(value, written)

    def _continue(self) -> None:
        if self._saved == self.is_set:  # it was changed, and changed back
            waiting, self._waiting = self._waiting, []
            for then in waiting:
                then()
        self.save()
