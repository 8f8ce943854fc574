"""The devices that `trolley detect` knows, by how they are told: put together from their drivers.

A driver of another package that fails while it is asked is left out of the answer, and named.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from trolley.drivers import guarded
from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.boards.models import Answer, BoardQuestion
from trolley_base.drivers.lidars import MODELS
from trolley_base.drivers.lidars.models import Greeting

T = TypeVar("T")

FAILED: dict[str, str] = {}
"""Drivers that have failed while they were asked, by name, and how."""


def guard(name: str, function: Callable[..., T]) -> Callable[..., T | None]:
    """Return a driver's function that says None where it fails."""

    def note(how: str) -> None:
        FAILED.setdefault(name, how)

    return guarded(function, note)


def what_is_left_out() -> list[str]:
    """Return a sentence for each driver that cannot be used, or has failed."""
    refused = [str(one) for drivers in (BOARDS, MODELS) for one in drivers.refused()]
    return refused + [f"The driver of {name} has failed: {how}." for name, how in FAILED.items()]


class KnownBoard(NamedTuple):
    """A board, and a question by which it is told."""

    model: str
    question: BoardQuestion

    def recognise(self, data: bytes) -> Answer | None:
        """Find its answer; None while it is not there."""
        return guard(self.model, self.question.recognise)(data)

    def describe(self, answer: Answer) -> FoundDevice:
        """Say what was found."""
        facts = BOARDS[self.model].facts
        model = self.model if answer.is_usable else None
        title, baud = answer.title or facts.title, self.question.baud
        return FoundDevice("board", model, title, baud, answer.details, answer.problems)


_QUESTIONS = [
    KnownBoard(model, question) for model, driver in BOARDS.items() for question in driver.questions
]
LISTENED = [one for one in _QUESTIONS if not one.question.ask]
"""Boards that talk unasked."""


def _by_speed(questions: list[KnownBoard]) -> dict[int, list[KnownBoard]]:
    speeds = dict.fromkeys(one.question.baud for one in questions)
    return {baud: [one for one in questions if one.question.baud == baud] for baud in speeds}


TALKING = _by_speed(LISTENED)
"""The same, by their speeds."""
BOOTING = _by_speed([one for one in _QUESTIONS if one.question.boots])
"""Boards that may have been restarted by opening the port, by their speeds."""
ASKED = _by_speed([one for one in _QUESTIONS if not one.question.boots])
"""The others, by their speeds."""
STREAM_BAUDS = tuple(
    dict.fromkeys(
        [
            *(driver.facts.baud for driver in MODELS.values() if driver.frames is not None),
            *TALKING,
        ]
    )
)
"""The speeds at which a device may talk unasked."""
IDENTITIES = tuple(
    dict.fromkeys(
        (driver.identity, baud)
        for driver in MODELS.values()
        if driver.identity is not None
        for baud in (driver.facts.baud, *driver.facts.other_bauds)
    )
)
"""Which lidars are asked who they are, at which speeds."""
GREETINGS: tuple[tuple[str, Greeting, int], ...] = tuple(
    (model, driver.greeting, driver.facts.baud)
    for model, driver in MODELS.items()
    if driver.greeting is not None
)
"""Which lidars are asked in words of their own, at which speeds."""
STARTED: dict[int, list[str]] = {
    baud: [one for one, driver in MODELS.items() if driver.start and driver.facts.baud == baud]
    for baud in dict.fromkeys(driver.facts.baud for driver in MODELS.values() if driver.start)
}
"""Which lidars are started to be known by their frames, by their speed: all of one at once."""


def recognise_talking(data: bytes, baud: int) -> FoundDevice | None:
    """Find a board that talks unasked."""
    for known in TALKING.get(baud, ()):
        answer = known.recognise(data)
        if answer is not None:
            return known.describe(answer)
    return None
