"""How a service's methods are bound to messages, periods and requests: the decorators."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeVar

from trolley.requests import Request
from trolley.topics import Topic

F = TypeVar("F", bound=Callable[..., Any])

TimerClock = Literal["robot", "local"]
BINDINGS = "__trolley_bindings__"


@dataclasses.dataclass(frozen=True)
class Binding:
    """What a decorator asks of the runtime for one method."""

    kind: Literal["on", "on_delete", "every", "answers", "gets"]
    topic: Topic[Any] | None = None
    request: Request[Any, Any] | None = None
    parts: tuple[str, ...] = ()
    robot: str | None = None
    seconds: float = 0.0
    clock: TimerClock = "robot"
    wakes: bool = True
    when: Callable[[Any], bool] | None = None


def _bind(binding: Binding) -> Callable[[F], F]:
    def mark(method: F) -> F:
        setattr(method, BINDINGS, (*getattr(method, BINDINGS, ()), binding))
        return method

    return mark


def on(
    topic: Topic[Any], *parts: str, robot: str | None = None, wakes: bool = True
) -> Callable[[F], F]:
    """Call the method with each message of `topic`: `method(message, *varying_chunks)`.

    Sensor and command streams give the newest message of each key, state streams and stored keys
    every one. `parts` narrow the varying chunks; `robot="*"` listens to all robots, whose name then
    stands before the chunks. A method that only keeps the message for others need not be called as
    it comes (`wakes=False`): it is called before anything else that the service does then.
    """
    return _bind(Binding("on", topic=topic, parts=parts, robot=robot, wakes=wakes))


def on_delete(topic: Topic[Any], *parts: str) -> Callable[[F], F]:
    """Call `method(*varying_chunks)` when a key of `topic` is deleted.

    The chunks may hold wildcards where the contract allows them (markers, overlays).
    """
    return _bind(Binding("on_delete", topic=topic, parts=parts))


def every(
    seconds: float, clock: TimerClock = "robot", when: Callable[[Any], bool] | None = None
) -> Callable[[F], F]:
    """Call `method()` at this period of robot time, or of the local monotonic clock.

    Robot periods rest while there is no robot time; periods that were missed are skipped. Where
    there is mostly nothing to do, `when(owner)` says whether there is: nothing wakes the service
    for it meanwhile.
    """
    return _bind(Binding("every", seconds=seconds, clock=clock, when=when))


def answers(request: Request[Any, Any]) -> Callable[[F], F]:
    """Answer `request` with what `method(params)` returns; it raises `Refused` to refuse.

    A method that cannot answer yet returns `self.later()` and answers through it within 2 s.
    """
    return _bind(Binding("answers", request=request))


def gets(topic: Topic[Any], *parts: str) -> Callable[[F], F]:
    """Answer `get` of `topic` by `method(parameters) -> {varying_chunks: message}`.

    Only where the latest published value is not the answer: stored keys, `goal?id=`. The runtime
    picks what the asked key covers and refuses an unknown exact key with `unknown_name`.
    """
    return _bind(Binding("gets", topic=topic, parts=parts))


def bindings_of(*owners: object) -> list[tuple[Binding, Callable[..., Any]]]:
    """Every bound method of a service and its parts: owner by owner, in the order of definition."""
    return [
        (binding, getattr(owner, name))
        for owner in owners
        for name, bindings in _marked(type(owner)).items()
        for binding in bindings
    ]


def _marked(kind: type) -> dict[str, tuple[Binding, ...]]:
    """The bindings of a class's methods by name; a subclass's method stands for its base's."""
    found: dict[str, tuple[Binding, ...]] = {}
    members: Mapping[str, Any]
    for cls in kind.__mro__:
        members = vars(cls)
        for name, member in members.items():
            found.setdefault(name, getattr(member, BINDINGS, ()))
    return found
