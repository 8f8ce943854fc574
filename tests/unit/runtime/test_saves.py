"""State files written in the background, while others wait to be written."""

from collections.abc import Callable
from pathlib import Path

import msgspec

from trolley.runtime.log import Log
from trolley.runtime.saves import Saves
from trolley.runtime.state import StateFolder

Job = tuple[Callable[[], object], Callable[[object], None]]


class Kept(msgspec.Struct):
    number: int


class Counted(StateFolder):
    """A folder that notes each write, and may be full."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, Log("test"))
        self.written: list[tuple[str, int]] = []
        self.is_full = False

    def write(self, name: str, value: msgspec.Struct, *, is_secret: bool = False) -> None:
        if self.is_full:
            raise OSError(28, "No space left on device")
        assert isinstance(value, Kept)
        self.written.append((name, value.number))
        super().write(name, value, is_secret=is_secret)


class Worker:
    """Jobs that wait until they are run, and the saves that make them."""

    def __init__(self, folder: Counted) -> None:
        self._jobs: list[Job] = []
        self._saves = Saves(folder, lambda fn, then: self._jobs.append((fn, then)))
        self.heard: list[tuple[str, int, OSError | None]] = []

    def save(self, name: str, number: int) -> None:
        def hear(error: OSError | None) -> None:
            self.heard.append((name, number, error))

        self._saves.save(name, Kept(number), hear, is_secret=False)

    def run(self) -> None:
        while self._jobs:
            fn, then = self._jobs.pop(0)
            then(fn())


def test_of_what_waits_for_one_file_only_the_newest_is_written(tmp_path: Path) -> None:
    folder = Counted(tmp_path)
    worker = Worker(folder)
    for number in range(100):
        worker.save("places.toml", number)
    worker.run()
    assert folder.written == [("places.toml", 99)]
    assert folder.read("places.toml", Kept) == Kept(99)
    assert worker.heard == [("places.toml", number, None) for number in range(100)]


def test_files_keep_the_order_of_what_is_newest_in_them(tmp_path: Path) -> None:
    folder = Counted(tmp_path)
    worker = Worker(folder)
    for name, number in (("a.toml", 1), ("b.toml", 2), ("a.toml", 3)):
        worker.save(name, number)
    worker.run()
    assert folder.written == [("b.toml", 2), ("a.toml", 3)]


def test_who_was_superseded_hears_that_the_newer_one_failed(tmp_path: Path) -> None:
    folder = Counted(tmp_path)
    worker = Worker(folder)
    worker.save("places.toml", 1)
    worker.save("places.toml", 2)
    folder.is_full = True
    worker.run()
    assert [(number, error is not None) for _, number, error in worker.heard] == [
        (1, True),
        (2, True),
    ]
    folder.is_full = False
    worker.save("places.toml", 3)
    worker.run()
    assert worker.heard[-1] == ("places.toml", 3, None)
    assert folder.read("places.toml", Kept) == Kept(3)
