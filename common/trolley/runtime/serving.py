"""What a service publishes and answers: its topics, `get` of them, and requests under `@do/`."""

import dataclasses
import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar, cast

from trolley import codes
from trolley.codes import Refused
from trolley.invalid import in_plain_words
from trolley.messages import ErrorReply
from trolley.names import canonical
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Closer, Newest, Query, has_wildcard, matches
from trolley.runtime.context import Context
from trolley.topics import Topic

R = TypeVar("R")

MAX_REQUEST_BYTES = 1 << 20
ANSWER_WITHIN_S = 1.9
MAX_WAITING = 256
"""How many requests of one key may wait; more are refused unread."""
_TOO_MANY = codec.encode(
    ErrorReply(
        code=codes.NOT_READY, message="Too many such requests are waiting already; ask again later."
    ),
    "json",
)

Hook = Callable[[dict[str, str]], dict[tuple[str, ...], Any]]


class Later(Generic[R]):
    """An answer that is still to come: call `reply` or `refuse` once, within 2 s."""

    def __init__(self) -> None:
        self._done: Callable[[R | Refused], None] | None = None
        self._result: R | Refused | None = None

    @property
    def is_open(self) -> bool:
        """Whether it still waits for its answer."""
        return self._result is None

    def reply(self, value: R) -> None:
        """Answer."""
        self._settle(value)

    def refuse(self, refusal: Refused) -> None:
        """Refuse."""
        self._settle(refusal)

    def on_settled(self, done: Callable[[R | Refused], None]) -> None:
        """Call `done` with the answer, at once if it is there (called by the runtime)."""
        self._done = done
        if self._result is not None:
            done(self._result)

    def _settle(self, result: R | Refused) -> None:
        if self._result is None:
            self._result = result
            if self._done is not None:
                self._done(result)


@dataclasses.dataclass(frozen=True)
class _Unmade:
    """A message that nobody heard, so that it was not made."""

    make: Callable[[], Any]


class Server:
    """Publishes and answers for a service."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._closers: list[Closer] = []
        self._latest: dict[str, Any] = {}
        self._answering: dict[str, Closer] = {}
        self._hooked: set[str] = set()
        self._newest: dict[str, tuple[Topic[Any], Newest]] = {}

    def close(self) -> None:
        """Take everything off the bus."""
        for closer in self._closers:
            closer.close()
        for _, newest in self._newest.values():
            newest.close()

    # What it publishes.
    def publish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None = None
    ) -> None:
        """Publish a message and keep it for `get`."""
        key = topic.key(robot or self._context.robot, *parts)
        self._latest[key] = message
        self._answer_for(topic, key)
        self._context.bus.put(
            key, codec.encode(message, "msgpack"), codec.MIME["msgpack"], topic.qos
        )

    def publish_if_heard(
        self, topic: Topic[Any], make: Callable[[], Any], parts: tuple[str, ...]
    ) -> None:
        """Publish what is costly to make; where nobody listens it is made once it is asked for."""
        key = topic.key(self._context.robot, *parts)
        if self._context.bus.is_heard(key, codec.MIME["msgpack"]):
            self.publish(topic, make(), parts)
            return
        self._latest[key] = _Unmade(make)
        self._answer_for(topic, key)

    def _answer_for(self, topic: Topic[Any], key: str) -> None:
        """Answer gets of what is published, and notice who else does."""
        context = self._context
        if topic.is_exclusive and key not in self._newest:
            self._newest[key] = topic, context.bus.newest(key)
        if key not in self._answering and topic.name not in self._hooked:
            self._answering[key] = self._serve(
                key, lambda query: self._answer_get(query, topic, lambda _: self._published(key))
            )

    def put_wish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None:
        """Put a key that another service owns, or delete it (None)."""
        bus, key = self._context.bus, topic.key(robot or self._context.robot, *parts)
        if message is None:
            bus.delete(key)
        else:
            bus.put(key, codec.encode(message, "msgpack"), codec.MIME["msgpack"], topic.qos)

    def withdraw(self, topic: Topic[Any], parts: tuple[str, ...]) -> None:
        """Stop answering `get` of a key until something is published there again."""
        key = topic.key(self._context.robot, *parts)
        self._latest.pop(key, None)
        if key in self._newest:
            self._newest.pop(key)[1].close()
        closer = self._answering.pop(key, None)
        if closer is not None:
            closer.close()
            self._closers.remove(closer)

    def restore_overwritten(self) -> None:
        """Publish again what somebody else has overwritten on keys of this service alone.

        Otherwise what a stranger published, a map perhaps, would hold until the next change.
        """
        for key, (topic, newest) in self._newest.items():
            heard = newest.take()
            if heard is None or key not in self._latest:
                continue
            payload = codec.encode(self._latest[key], "msgpack")
            if heard != payload:
                self._context.bus.put(key, payload, codec.MIME["msgpack"], topic.qos)
                self._context.count(f"{topic.chunks[0]}/overwritten")
                why = "another program published on this key"
                self._context.log.limited(
                    f"{topic.name}/overwritten", "Published again", key=key, why=why
                )

    def _published(self, key: str) -> dict[str, Any]:
        if key not in self._latest:
            return {}
        latest = self._latest[key]
        if isinstance(latest, _Unmade):
            latest = self._latest[key] = latest.make()
        return {key: latest}

    def open_gets(self, topic: Topic[Any], parts: tuple[str, ...], hook: Hook) -> None:
        """Answer `get` of a topic by a method of the service."""
        if not parts:
            self._hooked.add(topic.name)
        robot = self._context.robot

        def look_up(parameters: dict[str, str]) -> dict[str, Any]:
            return {
                topic.key(robot, *found): message for found, message in hook(parameters).items()
            }

        self._serve(topic.key(robot, *parts), lambda query: self._answer_get(query, topic, look_up))

    def _answer_get(
        self, query: Query, topic: Topic[Any], look_up: Callable[[dict[str, str]], dict[str, Any]]
    ) -> None:
        parameters = codec.parse_parameters(query.parameters)
        fmt = codec.format_asked(parameters, "msgpack" if topic.binary_get else "json")
        asked = query.key
        exact = not has_wildcard(asked)
        try:
            found = look_up(parameters)
        except Refused as refused:
            if exact:
                self._refuse(query, refused)
            query.finish()
            return
        # Under a wildcard an answer must stand on a key that was asked for, letter by letter.
        pattern = canonical(asked) if exact else asked
        answered = False
        for key, message in found.items():
            if matches(pattern, key):
                query.reply(asked if exact else key, codec.encode(message, fmt), codec.MIME[fmt])
                answered = True
        if exact and not answered:
            self._refuse(query, _nothing_of(topic, asked, parameters))
        query.finish()

    # Requests.
    def open_request(self, request: Request[Any, Any], method: Callable[[Any], Any]) -> None:
        """Answer a request by a method of the service."""
        key = request.key(self._context.robot)
        self._serve(
            key, lambda query: self._answer(query, request, method, key), urgent=request.always
        )

    def _answer(
        self, query: Query, request: Request[Any, Any], method: Callable[[Any], Any], key: str
    ) -> None:
        parameters = codec.parse_parameters(query.parameters)
        fmt = codec.format_asked(parameters, "json")
        parameters.pop("format", None)
        settled = False

        def settle(result: Any) -> None:
            nonlocal settled
            if settled:
                return
            settled = True
            if isinstance(result, Refused):
                self._context.count(f"{request.name}/{result.code}")
                self._refuse(query, result)
            else:
                query.reply(key, codec.encode(result, fmt), codec.MIME[fmt])
            query.finish()

        try:
            result = method(_parameters(query, request, parameters))
        except Refused as refused:
            settle(refused)
            return
        except Exception:
            settle(Refused(codes.INTERNAL))
            raise
        if isinstance(result, Later):
            cast("Later[Any]", result).on_settled(settle)
            self._context.after(ANSWER_WITHIN_S, lambda: settle(Refused(codes.TIMEOUT)))
        else:
            settle(result)

    def _refuse(self, query: Query, refused: Refused) -> None:
        error = ErrorReply(code=refused.code, message=refused.message, details=refused.details)
        query.refuse(codec.encode(error, "json"), codec.MIME["json"])

    def _serve(self, key: str, answer: Callable[[Query], None], *, urgent: bool = False) -> Closer:
        inbox = self._context.inbox
        room = threading.Semaphore(MAX_WAITING)

        def receive(query: Query) -> None:
            # A flood costs little here, and leaves the inbox to what others send.
            may_wait = urgent or room.acquire(blocking=False)
            if may_wait and inbox.push(lambda _: take(query), urgent=urgent):
                return
            if may_wait and not urgent:
                room.release()
            self._context.count("requests/too_many")
            query.refuse(_TOO_MANY, codec.MIME["json"])
            query.finish()

        def take(query: Query) -> None:
            if not urgent:
                room.release()
            answer(query)

        closer = self._context.bus.serve(key, receive)
        self._closers.append(closer)
        return closer


def _nothing_of(topic: Topic[Any], asked: str, parameters: dict[str, str]) -> Refused:
    """Refuse a `get` of something that does not exist: by its key, or by its id."""
    name = parameters.get("id", asked.rpartition("/")[2])
    return Refused(codes.UNKNOWN_NAME, f"There is no {name!r} under {topic.chunks[0]}.", name=name)


def _parameters(query: Query, request: Request[Any, Any], parameters: dict[str, str]) -> Any:
    """Validate what a request carries.

    Raises:
        Refused: `bad_request` or `too_large`.
    """
    # Only which robot is meant may be left open, and only where the request is for all of them.
    is_for_all = request.always and query.key.endswith(f"/@do/{request.name}")
    if has_wildcard(query.key) and not is_for_all:
        raise Refused(
            codes.BAD_REQUEST, "A request is asked of one robot: its key may hold no wildcard."
        )
    if request.always:
        return request.params()
    payload = query.payload
    if len(payload) > MAX_REQUEST_BYTES:
        raise Refused(
            codes.TOO_LARGE, f"{len(payload)} bytes, at most {MAX_REQUEST_BYTES} are allowed."
        )
    if parameters and payload:
        raise Refused(
            codes.BAD_REQUEST, "Give parameters in the selector or in the payload, not both."
        )
    try:
        if parameters:
            return codec.decode_parameters(request.params, parameters)
        return codec.decode_strict(request.params, payload, query.encoding)
    except codec.BadPayload as problem:
        words = in_plain_words(str(problem), request.params)
        raise Refused(codes.BAD_REQUEST, f"{request.name}: {words}.") from problem
