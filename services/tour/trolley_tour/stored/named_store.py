"""Named values in one file: every change is saved before it counts."""

from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from msgspec import Struct

from trolley import codes
from trolley.codes import Refused
from trolley.messages import SavedPose, Tour
from trolley.runtime.service import Later, Service
from trolley_tour.stored.checks import without_item

T = TypeVar("T", SavedPose, Tour)
Change = Callable[[Mapping[str, T]], tuple[dict[str, T], T]]
"""Returns the values after the change and the one it is about, or raises `Refused`."""
Answer = Callable[[T | Refused], None]
Save = Callable[[Struct, Callable[[str | None], None]], None]
"""Saves a file, then calls back with None, or a sentence on why it could not be saved."""

MAX_PENDING = 10_000
"""Changes that wait for the disk; more are refused."""


class NamedStore(Generic[T]):
    """The values by name.

    Args:
        kind: What one of them is called.
        to_file: Makes the file's content of them.
        save: Saves it.
        on_change: Called after a change was saved.
    """

    def __init__(
        self,
        kind: str,
        to_file: Callable[[list[T]], Struct],
        save: Save,
        on_change: Callable[[], None],
    ) -> None:
        self.items: dict[str, T] = {}
        self._kind = kind
        self._to_file = to_file
        self._save = save
        self._on_change = on_change
        self._pending: list[tuple[Change[T], Answer[T]]] = []
        self._is_saving = False

    def change(self, change: Change[T], answer: Answer[T]) -> None:
        """Apply a change; `answer` gets the value it is about once it is saved, or a refusal.

        Changes that come while the disk is busy are saved together.
        """
        if len(self._pending) >= MAX_PENDING:
            answer(Refused(codes.NOT_SAVED, "Too many changes are waiting for the disk."))
            return
        self._pending.append((change, answer))
        if not self._is_saving:
            self._save_pending()

    def delete(self, name: str, answer: Answer[T]) -> None:
        """Delete a value; `answer` gets it, or a refusal."""
        self.change(lambda items: without_item(items, name, self._kind), answer)

    def _save_pending(self) -> None:
        pending, self._pending = self._pending, []
        items = self.items
        applied: list[tuple[Answer[T], T]] = []
        for change, answer in pending:
            try:
                items, item = change(items)
            except Refused as refused:
                answer(refused)
            else:
                applied.append((answer, item))
        if applied:
            self._is_saving = True
            content = self._to_file(list(items.values()))
            self._save(content, lambda problem: self._saved(items, applied, problem))

    def _saved(
        self, items: dict[str, T], applied: list[tuple[Answer[T], T]], problem: str | None
    ) -> None:
        self._is_saving = False
        if problem is None:
            self.items = items
            self._on_change()
        for answer, item in applied:
            answer(item if problem is None else Refused(codes.NOT_SAVED, problem))
        if self._pending:
            self._save_pending()


class WishLog:
    """Counts and logs why wishes by key were refused: nobody waits for their answer.

    Args:
        service: Whose counters and log.
        kind: What is wished for, such as `poses`.
    """

    def __init__(self, service: Service, kind: str) -> None:
        self._service = service
        self._kind = kind

    def note_result_of(self, name: str) -> Callable[[object], None]:
        """An `Answer` to the wish about `name`."""

        def note(result: object) -> None:
            if isinstance(result, Refused):
                counter = f"{self._kind}/{result.code}"
                self._service.count(counter)
                self._service.log.limited(counter, "Refused", name=name, why=result.message)

        return note


def answer_later(later: Later[T]) -> Answer[T]:
    """An `Answer` that answers a request with the value or the refusal."""

    def answer(result: T | Refused) -> None:
        if isinstance(result, Refused):
            later.refuse(result)
        else:
            later.reply(result)

    return answer
