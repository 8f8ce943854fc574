"""The service's state files; one that cannot be saved is reported in `health`."""

from collections.abc import Callable
from typing import TypeVar

from msgspec import Struct

from trolley.runtime.service import Service
from trolley_tour.problems import Problems

F = TypeVar("F", bound=Struct)


class StateFiles:
    """Reads and saves the files of this robot's state."""

    def __init__(self, service: Service, problems: Problems) -> None:
        self._service = service
        self._problems = problems

    def read(self, name: str, kind: type[F]) -> F | None:
        """Read a file, None where there is none or it cannot be used."""
        return self._service.state.read(name, kind)

    def say_doubled(self, name: str, doubled: list[str]) -> None:
        """Say, until the file is saved, which names stood in it more than once."""
        if doubled:
            listed = ", ".join(map(repr, dict.fromkeys(doubled)))
            sentence = (
                f"{name} has several entries called {listed}: the first keeps the name, the others "
                "got numbers."
            )
            self._service.log.warning(sentence)
            self._problems.set(name, sentence)

    def save(self, name: str, content: Struct, then: Callable[[str | None], None]) -> None:
        """Save a file, then call back with None, or a sentence on why it could not be saved."""

        def saved(error: OSError | None) -> None:
            problem = None
            if error is not None:
                problem = f"{name} could not be saved: {error.strerror}."
                self._service.count(f"{name}/not_saved")
                self._service.log.error("A file could not be saved", file=name, why=problem)
            self._problems.set(name, problem)
            then(problem)

        self._service.save(name, content, saved)
