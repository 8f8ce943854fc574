"""The service's state files; what goes wrong with them is reported in `health`."""

from collections.abc import Callable
from typing import TypeVar

from msgspec import Struct

from trolley.runtime.service import Service
from trolley_tour.health import Problems

F = TypeVar("F", bound=Struct)


class StateFiles:
    """Reads and saves the files of this robot's state."""

    def __init__(self, service: Service, problems: Problems) -> None:
        self._service = service
        self._problems = problems
        self._locked: dict[str, str] = {}
        """Files that must not be overwritten, and why."""

    def read(self, name: str, kind: type[F]) -> F | None:
        """Read a file, None where there is none; a broken one is set aside and reported."""
        path = self._service.state.path / name
        existed = path.exists()
        content = self._service.state.read(name, kind)
        if content is None and existed:
            if path.exists():  # it could not even be set aside, so it must not be overwritten
                self._locked[name] = f"{name} cannot be read; nothing new is saved in it."
                self._problems.set(name, self._locked[name])
            else:
                self._problems.set(f"{name} before", f"{name} could not be read and was set aside.")
        return content

    def save(self, name: str, content: Struct, then: Callable[[str | None], None]) -> None:
        """Save a file, then call back with None, or a sentence on why it could not be saved."""
        if name in self._locked:
            then(self._locked[name])
            return

        def saved(error: OSError | None) -> None:
            problem = None
            if error is not None:
                problem = f"{name} could not be saved: {error.strerror}."
                self._service.count(f"{name}/not_saved")
                self._service.log.error("A file could not be saved", file=name, why=problem)
            self._problems.set(name, problem)
            then(problem)

        self._service.save(name, content, saved)
