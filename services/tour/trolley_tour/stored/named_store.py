"""Named things in one file: every change is saved before it counts."""

from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from msgspec import Struct

from trolley import codes
from trolley.codes import Refused
from trolley.messages import SavedPose, Tour

T = TypeVar("T", SavedPose, Tour)
Items = Mapping[str, T]
Change = Callable[[Mapping[str, T]], tuple[dict[str, T], T]]
"""Gives the things after the change and the one that it is about, or raises `Refused`."""
Answer = Callable[[T | Refused], None]
Save = Callable[[Struct, Callable[[str | None], None]], None]
"""Saves a file, then calls back with what kept it from being saved."""

MAX_WAITING = 10_000


class Shelf(Generic[T]):
    """The things by name.

    Args:
        to_file: Makes the file's content of them.
        save: Saves it.
        changed: Called after a change was saved.
    """

    def __init__(
        self, to_file: Callable[[list[T]], Struct], save: Save, changed: Callable[[], None]
    ) -> None:
        self.items: dict[str, T] = {}
        self._to_file = to_file
        self._save = save
        self._changed = changed
        self._waiting: list[tuple[Change[T], Answer[T]]] = []
        self._is_saving = False

    def change(self, change: Change[T], answer: Answer[T]) -> None:
        """Change the things; `answer` gets the one that it is about once it is saved, or a refusal.

        Changes that come while the disk is busy are saved together.
        """
        if len(self._waiting) >= MAX_WAITING:
            answer(Refused(codes.NOT_SAVED, "Too many changes wait for the disk."))
            return
        self._waiting.append((change, answer))
        if not self._is_saving:
            self._save_waiting()

    def _save_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        items = self.items
        done: list[tuple[Answer[T], T]] = []
        for change, answer in waiting:
            try:
                items, item = change(items)
            except Refused as refused:
                answer(refused)
            else:
                done.append((answer, item))
        if done:
            self._is_saving = True
            content = self._to_file(list(items.values()))
            self._save(content, lambda problem: self._saved(items, done, problem))

    def _saved(
        self, items: dict[str, T], done: list[tuple[Answer[T], T]], problem: str | None
    ) -> None:
        self._is_saving = False
        if problem is None:
            self.items = items
            self._changed()
        for answer, item in done:
            answer(item if problem is None else Refused(codes.NOT_SAVED, problem))
        if self._waiting:
            self._save_waiting()
