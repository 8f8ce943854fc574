"""The bus over Eclipse Zenoh, and the router that carries it.

Callbacks only store, and a session is always closed: else it hangs at exit.
"""

# Zenoh's stubs leave most of its results without a type.

import atexit
import ctypes
import os
import threading
import time
import weakref
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

import zenoh

from trolley.runtime.bus import Query, Reply, Sample
from trolley.runtime.door.keeper import Door
from trolley.runtime.endpoints import SOCKET, is_far, is_forbidden, why_not_here
from trolley.runtime.far_links import FarLinks, watched
from trolley.runtime.log import Log
from trolley.runtime.open_files import allow_many_files
from trolley.runtime.uplink_sockets import FarLink, far_ports, given_up_when_unanswered
from trolley.runtime.zenoh_config import client_config, router_config
from trolley.security.access import Security
from trolley.security.host_keys import HostKeys
from trolley.topics import Qos

MOST_KNOWN = 16
"""Threads of Zenoh's that Python keeps in mind; it receives on one or two."""

ONE_RECEIVER = "ZENOH_RUNTIME", "(rx: (worker_threads: 1))"
"""A service receives over one link: a second thread of Zenoh's would only be woken for nothing."""

LARGEST = 33 << 20
"""No message is larger; a larger payload is not even copied before it is refused."""

MOST_PUBLISHERS = 200
"""Keys whose publishers are kept: more than a service has streams, and a bound where keys vary."""

MOST_OPENINGS = 3
ANSWERS_S = 5.0
"""A new router in which no program gets a session for so long is opened anew, but not for ever."""

NOBODY = "trolley/@nobody"
"""A key that nobody uses: the router's own answer to it is enough."""

ENDING_S = 1.0
"""Python ends in less [s]. A thread that comes back from Zenoh meanwhile would abort it."""

CALLBACK_S = 5.0
"""How long a callback may go on after the session has ended."""
INSIDE_S = 0.5
"""How long what is being asked or told may go on before the session is ended."""
LOOK_S = 0.002
"""How often it is looked whether they are over."""

SOCKET_MODE = 0o660
"""A Unix socket is for its owner and its group; Zenoh leaves it to its owner alone."""

_PRIORITIES = {
    Qos.SENSOR: (zenoh.Priority.INTERACTIVE_HIGH, zenoh.CongestionControl.DROP, False),
    Qos.COMMAND: (zenoh.Priority.REAL_TIME, zenoh.CongestionControl.DROP, True),
    Qos.STATE: (zenoh.Priority.DATA_LOW, zenoh.CongestionControl.BLOCK, False),
}


ZenohError = zenoh.ZError
"""What the library raises, such as of a session that another thread has closed."""


FORKED = (
    "this process was forked from one that is or was connected to a robot, and cannot be itself: "
    'begin it anew, as multiprocessing does with set_start_method("spawn")'
)


class NotConnected(Exception):
    """No router answers at the endpoints; the text says what to do."""


def _why_not_listening(listen: Sequence[str], error: Exception) -> str:
    """Say why a router cannot be opened; Zenoh has much the same words for everything."""
    for one in listen:
        folder = Path(one.removeprefix(SOCKET)).parent
        if one.startswith(SOCKET) and not folder.is_dir():
            return f"cannot listen at {one}: there is no folder {folder}"
    return f"cannot listen at {', '.join(listen)}: is another router running there? ({error})"


@contextmanager
def open_router(
    listen: Sequence[str],
    uplink: Sequence[str] = (),
    security: Security | None = None,
    downsample: Mapping[str, float] | None = None,
) -> Generator[None]:
    """Be the router while the context lasts; the arguments are those of `router_config`.

    Raises:
        NotConnected: It cannot listen: the port is taken, the keys cannot be used, or nothing
            would limit who comes in there.
    """
    for one in listen:
        has_rules = security is not None and security.access_control is not None
        if why_not := why_not_here(one, has_rules=has_rules):
            raise NotConnected(f"will not listen at {one}: {why_not}")
    for one in uplink:
        if not is_far(one):
            raise NotConnected(f"will not link to {one}: routers of two hosts meet at tls/ only")
    zenoh.init_log_from_env_or("off")
    allow_many_files()
    with ExitStack() as stack:
        try:
            doors = [stack.enter_context(closing(Door(one))) for one in listen if is_far(one)]
            near = [one for one in listen if not is_far(one)]
            inside = [*near, *(one for door in doors for one in door.inside)]
            config = router_config(inside, uplink, security, downsample)
            session = open_answering(
                lambda: zenoh.open(config), lambda: takes_new_sessions(near, ANSWERS_S)
            )
        except (zenoh.ZError, OSError, ValueError) as error:
            raise NotConnected(_why_not_listening(listen, error)) from error
        stack.enter_context(session)
        for one in listen:
            if one.startswith(SOCKET):
                Path(one.removeprefix(SOCKET)).chmod(SOCKET_MODE)
        stack.enter_context(given_up_when_unanswered(uplink))
        for door in doors:
            stack.enter_context(door.kept_open())
        if security is not None:
            far = FarLinks(uplink, security.allowed, Log("router"), time.monotonic())
            stack.enter_context(watched(lambda: _far_links(session), far))
        yield


def _far_links(session: zenoh.Session) -> list[FarLink]:
    return [
        FarLink(own_port, port, one.auth_identifier)
        for one in session.info.links()
        if one.auth_identifier is not None
        for own_port in far_ports([one.src])
        for port in far_ports([one.dst])
    ]


class Closable(Protocol):
    """What is open."""

    def close(self) -> object:
        """Close it."""
        ...


Opened = TypeVar("Opened", bound=Closable)
T = TypeVar("T")


def open_answering(open_one: Callable[[], Opened], answers: Callable[[], bool]) -> Opened:
    """Open a router's session, anew where nobody gets in.

    One in some ten thousand takes no session from the start, though it listens (zenoh issue 2780).
    The last is kept in any case: the machine may only be too busy to answer.
    """
    for _ in range(MOST_OPENINGS - 1):
        with ExitStack() as stack:
            session = stack.enter_context(closing(open_one()))
            if answers():
                stack.pop_all()
                return session
    return open_one()


def takes_new_sessions(endpoints: Sequence[str], patience_s: float) -> bool:
    """Whether a program that began now would be served; true if there is no endpoint for it.

    A router in which nothing but its old sessions works is dead to `trolley stop`.
    """
    if not endpoints:
        return True
    try:
        with open_bus(endpoints[:1], patience_s) as bus:
            bus.alive(NOBODY, patience_s)
    except NotConnected:
        return False
    return True


class _KnownThreads:
    """Spares Python to meet a thread of Zenoh's anew with each call from it.

    What Python keeps of a thread it did not start, it throws away when the call ends: a third of
    what a small message costs. A thread that takes the lock once more than it gives it back stays
    known. It never gives it back: only where the process ends without Python's own shutdown.
    """

    def __init__(self) -> None:
        self._known: set[int] = set()

    def __call__(self, callback: Callable[[Any], object]) -> Callable[[Any], None]:
        """Call `callback`, on a thread that is known from its first call on."""
        known = self._known

        def call(what: Any) -> None:
            thread = threading.get_ident()
            if thread not in known and len(known) < MOST_KNOWN:
                known.add(thread)
                ctypes.pythonapi.PyGILState_Ensure()
            callback(what)

        return call


class _ZenohQuery:
    """A query that came over the network; what it holds is read only when it is asked for."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query: zenoh.Query | None = query
        self._asked = query

    @property
    def key(self) -> str:
        return str(self._asked.key_expr)

    @property
    def parameters(self) -> str:
        return str(self._asked.parameters)

    @property
    def payload(self) -> bytes:
        return _read(self._asked.payload) if self._asked.payload is not None else b""

    @property
    def encoding(self) -> str:
        return str(self._asked.encoding) if self._asked.encoding is not None else ""

    def reply(self, key: str, payload: bytes, encoding: str) -> None:
        if self._query is not None:
            self._query.reply(key, payload, encoding=encoding)

    def refuse(self, payload: bytes, encoding: str) -> None:
        if self._query is not None:
            self._query.reply_err(payload, encoding=encoding)

    def finish(self) -> None:
        if self._query is not None:
            self._query.drop()
            self._query = None


_opened_in: set[int] = set()
"""Processes that have opened a session: this one, and those that it was forked from."""
_living: "weakref.WeakSet[ZenohBus | _Declared]" = weakref.WeakSet()
"""What takes itself back at its end."""


def is_forked() -> bool:
    """Whether this process was forked from one that used Zenoh, whose threads are not here."""
    return not _opened_in <= {os.getpid()}


def _keep_after_fork() -> None:
    """Keep what a forked process has of its parent's sessions: dropping it would wait for ever."""
    for one in list(_living):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(one))


os.register_at_fork(after_in_child=_keep_after_fork)


class _Declared:
    """A subscriber, queryable or token that can be taken back."""

    def __init__(self, undeclare: Callable[[], object], inside: "_Inside") -> None:
        self._undeclare, self._inside = undeclare, inside
        _living.add(self)

    def close(self) -> None:
        if not is_forked():
            with suppress(ZenohError), self._inside:
                self._undeclare()


class _Served:
    """A key of which gets are answered, or once it is closed are ended at once.

    It is never taken back: Zenoh's router would go on asking for an answer after the session has
    ended, and each get of the key would last until its deadline (zenoh issue 2454).
    """

    def __init__(self) -> None:
        self.callback: Callable[[Query], None] | None = None

    def take(self, query: zenoh.Query) -> None:
        asked, callback = _ZenohQuery(query), self.callback
        if callback is None:
            asked.finish()
        else:
            callback(asked)

    def close(self) -> None:
        self.callback = None


class _Newest:
    """What a ring of one place holds: a flood costs no work in Python."""

    def __init__(self, subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]) -> None:
        self._subscriber = subscriber

    def take(self) -> bytes | None:
        sample = self._subscriber.try_recv()
        return None if sample is None else _read(sample.payload)

    def close(self) -> None:
        self._subscriber.undeclare()


class _Heard:
    """Whether anybody hears a publisher; asking Zenoh each time costs as much as to publish.

    Args:
        publisher: of the stream.
        handler: makes what the library calls back.
    """

    def __init__(
        self,
        publisher: "zenoh.Publisher",
        handler: "Callable[[Callable[[Any], object]], zenoh.handlers.Callback[Any]]",
    ) -> None:
        self._told: bool | None = None
        self._listener = publisher.declare_matching_listener(handler(self._take))
        status: Any = publisher.matching_status  # its stub says bool
        self._began = bool(status.matching)

    def _take(self, status: Any) -> None:
        self._told = bool(status.matching)

    @property
    def is_heard(self) -> bool:
        return self._began if self._told is None else self._told


class _Calls:
    """Those to a subscriber or asker, on a thread of their own."""

    def __init__(self) -> None:
        # A plain flag: a signal may not wait for a threading.Event whose `wait` it interrupts.
        self.are_over = False
        """Whether there will be no more of them; the thread has still to give back what it has."""
        self._thread: threading.Thread | None = None

    def note_thread(self) -> None:
        """Note that this is theirs."""
        if self._thread is None:
            self._thread = threading.current_thread()

    def end(self) -> None:
        """Note on their thread that there are no more."""
        self.note_thread()
        self.are_over = True

    @property
    def is_over(self) -> bool:
        """Whether their thread has ended."""
        return self.are_over and (self._thread is None or not self._thread.is_alive())

    @property
    def are_mine(self) -> bool:
        """Whether this is their thread."""
        return self._thread is threading.current_thread()


class _Inside:
    """The threads that are inside Zenoh; none gets in once the session has been closed."""

    def __init__(self) -> None:
        self.is_closed = False
        self._threads: list[int] = []

    def __enter__(self) -> None:
        self._threads.append(threading.get_ident())
        if self.is_closed:
            self.__exit__()
            raise ZenohError("the session is closed")

    def __exit__(self, *_: object) -> None:
        self._threads.remove(threading.get_ident())

    @property
    def is_empty(self) -> bool:
        """Whether none is there but this one."""
        return set(self._threads) <= {threading.get_ident()}


class ZenohBus:
    """A session with the router; use `open_bus`.

    Args:
        session: it, open.
        calls_directly: call back on the threads that receive, in place of one for each subscriber
            and question. It is for callbacks that only store, in a process that ends without
            Python's own shutdown: a thread of Zenoh's that asks for Python's lock then aborts it.
        puts_apart: give each subscriber a thread all the same: what waits for Python's lock then is
            not received, so that a flood of one key would delay everything else by a second.
    """

    def __init__(
        self, session: zenoh.Session, *, calls_directly: bool = False, puts_apart: bool = False
    ) -> None:
        self._session = session
        self._calls_directly = calls_directly
        self._puts_directly = calls_directly and not puts_apart
        self._served: dict[str, list[_Served]] = {}
        self._publishers: dict[tuple[str, str], zenoh.Publisher] = {}
        self._heard: dict[tuple[str, str], _Heard] = {}
        self._kept: list[object] = []  # a token or listener whose handle is lost is taken back
        self._inside = _Inside()
        self._calls: set[_Calls] = set()
        _living.add(self)

    @property
    def session(self) -> zenoh.Session:
        """The session itself, for what no `Bus` has (within the runtime only)."""
        return self._session

    def close(self) -> None:
        """End the session, and wait for the other threads that call back or are still inside.

        A daemon that comes back from Zenoh while Python ends would abort the process.
        """
        if is_forked():
            return
        self._inside.is_closed = True
        # First: a question that the closing makes fail leaves a thread behind that nobody knows.
        _wait_for(lambda: self._inside.is_empty, INSIDE_S)
        self._session.close()
        others = [one for one in list(self._calls) if not one.are_mine]
        _wait_for(lambda: self._inside.is_empty and all(one.is_over for one in others), CALLBACK_S)

    def put(self, key: str, payload: bytes, encoding: str, qos: Qos) -> None:
        """Publish; without a router it is dropped, and a stream that nobody hears stays here."""
        with self._inside:
            self._put(key, payload, encoding, qos)

    def _put(self, key: str, payload: bytes, encoding: str, qos: Qos) -> None:
        publisher = self._publisher(key, encoding) if qos is Qos.SENSOR else None
        if publisher is not None:
            publisher.put(payload)
            return
        priority, congestion, express = _PRIORITIES[qos]
        self._session.put(
            key,
            payload,
            encoding=encoding,
            priority=priority,
            congestion_control=congestion,
            express=express,
        )

    def is_heard(self, key: str, encoding: str) -> bool:
        """Whether the router told of anybody who hears a sensor stream."""
        heard = self._heard.get((key, encoding))
        if heard is None:
            publisher = self._publisher(key, encoding)
            if publisher is None:
                return True
            heard = self._heard[key, encoding] = _Heard(publisher, self._handler)
        return heard.is_heard

    def _publisher(self, key: str, encoding: str) -> "zenoh.Publisher | None":
        """What knows whether anybody hears a stream; None where there are too many."""
        publisher = self._publishers.get((key, encoding))
        if publisher is None and len(self._publishers) < MOST_PUBLISHERS:
            priority, congestion, express = _PRIORITIES[Qos.SENSOR]
            publisher = self._publishers[key, encoding] = self._session.declare_publisher(
                key,
                encoding=encoding,
                priority=priority,
                congestion_control=congestion,
                express=express,
            )
        return publisher

    def delete(self, key: str) -> None:
        """Publish a deletion."""
        priority, congestion, express = _PRIORITIES[Qos.STATE]
        with self._inside:
            self._session.delete(
                key, priority=priority, congestion_control=congestion, express=express
            )

    def subscribe(self, key_expr: str, callback: Callable[[Sample], None]) -> _Declared:
        """Call back, on one of Zenoh's threads, for each put and delete that matches."""
        calls = _Calls()

        def receive(sample: zenoh.Sample) -> None:
            if self._inside.is_closed:
                return  # what still waits then is many, perhaps
            calls.note_thread()
            payload = _read(sample.payload)
            is_delete = not payload and sample.kind == zenoh.SampleKind.DELETE
            callback(Sample(str(sample.key_expr), payload, str(sample.encoding), is_delete))

        if self._puts_directly:
            handler = _handler(receive, None, is_direct=True)
            subscriber = self._session.declare_subscriber(key_expr, handler)
            return _Declared(subscriber.undeclare, self._inside)
        handler = _handler(receive, calls.end, is_direct=False)

        # Noted on the thread that declares: a signal that closes the bus meanwhile waits for that.
        def declare() -> "zenoh.Subscriber[None]":
            with self._inside, self._noted(calls):
                return self._session.declare_subscriber(key_expr, handler)

        return _Declared(_as_daemon(declare).undeclare, self._inside)

    @contextmanager
    def _noted(self, calls: _Calls) -> Generator[None]:
        """Note who is to be waited for, once it is begun."""
        self._calls.difference_update([one for one in list(self._calls) if one.is_over])
        self._calls.add(calls)
        try:
            yield
        except BaseException:
            calls.are_over = True  # perhaps there never was a thread
            raise

    def newest(self, key: str) -> _Newest:
        """Keep the newest of what anybody puts to a key, one's own puts too."""
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(1)
        return _Newest(self._session.declare_subscriber(key, ring))

    def serve(self, key_expr: str, callback: Callable[[Query], None]) -> _Served:
        """Call back, on one of Zenoh's threads, for each get that matches."""
        known = self._served.setdefault(key_expr, [])
        served = next((one for one in known if one.callback is None), None)
        if served is None:
            served = _Served()
            known.append(served)
            self._session.declare_queryable(key_expr, self._handler(served.take))
        served.callback = callback
        return served

    def get(
        self,
        selector: str,
        payload: bytes,
        encoding: str,
        timeout_s: float,
        on_reply: Callable[[Reply], None],
        on_done: Callable[[], None],
    ) -> None:
        """Ask everybody who serves the key; replies come on Zenoh's threads."""
        calls = _Calls()

        def end() -> None:
            on_done()
            calls.end()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                sample = reply.ok
                on_reply(Reply(str(sample.key_expr), _read(sample.payload), str(sample.encoding)))
            elif reply.err is not None:
                error = reply.err
                on_reply(Reply(selector, _read(error.payload), str(error.encoding), is_error=True))

        priority, _, express = _PRIORITIES[Qos.COMMAND]
        # Python itself waits for those of others than daemons.
        is_noted = not self._calls_directly and threading.current_thread().daemon
        with self._inside, self._noted(calls) if is_noted else nullcontext():
            self._session.get(
                selector,
                self._handler(receive, end if is_noted else on_done),
                payload=payload or None,
                encoding=encoding or None,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                priority=priority,
                express=express,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )

    # Beyond the `Bus`: liveliness and connection.
    def declare_token(self, key: str) -> _Declared:
        """Show a liveliness token while this session lives."""
        token = self._session.liveliness().declare_token(key)
        self._kept.append(token)
        return _Declared(token.undeclare, self._inside)

    def alive(self, key_expr: str, timeout_s: float = 1.0) -> list[str]:
        """The liveliness tokens that are shown now (waits for the answer)."""
        with self._inside:
            replies = self._session.liveliness().get(key_expr, timeout=timeout_s)
            return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def watch_tokens(self, key_expr: str, callback: Callable[[str, bool], None]) -> _Declared:
        """Call back with key and whether it appeared (else vanished), for present tokens too."""

        def receive(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        subscriber = self._session.liveliness().declare_subscriber(
            key_expr, self._handler(receive), history=True
        )
        self._kept.append(subscriber)
        return _Declared(subscriber.undeclare, self._inside)

    def on_connection(self, callback: Callable[[bool], None]) -> None:
        """Call back when the router is there (True) or lost (False)."""

        def receive(event: zenoh.TransportEvent) -> None:
            callback(event.kind == zenoh.SampleKind.PUT)

        self._kept.append(
            self._session.info.declare_transport_events_listener(self._handler(receive))
        )

    def _handler(
        self, callback: Callable[[Any], object], on_end: Callable[[], object] | None = None
    ) -> "zenoh.handlers.Callback[Any]":
        """What the library hands over to: `on_end` is called after the last."""
        return _handler(callback, on_end, is_direct=self._calls_directly)


@contextmanager
def open_bus(
    endpoints: Sequence[str], timeout_s: float | None = None, keys: HostKeys | None = None
) -> Generator[ZenohBus]:
    """Connect to the router; `timeout_s` None waits for it forever; `keys` are for `tls/`.

    Raises:
        NotConnected: Nobody answers within `timeout_s`.
    """
    zenoh.init_log_from_env_or("off")
    timeout_ms = -1 if timeout_s is None else int(timeout_s * 1000)
    opening = _open_apart(lambda: client_config(endpoints, timeout_ms, keys), timeout_s)
    try:
        session = opening.result()
    except zenoh.ZError as error:
        for one in endpoints:
            if is_forbidden(one):
                raise NotConnected(
                    f"this user may not use {one}: its group may, so `sudo adduser NAME trolley` "
                    "(or the group that owns it), and log in again"
                ) from error
        where = ", ".join(endpoints)
        raise NotConnected(
            f"no router answers at {where}; start one with `trolley up`, `trolley demo` or "
            f"`trolley router`, or name another with --connect"
        ) from error
    except BaseException:  # Ctrl-C
        if not opening.cancel() and opening.exception() is None:
            opening.result().close()
        raise
    bus = ZenohBus(session)
    try:
        yield bus
    finally:
        bus.close()


def open_bus_patiently(
    endpoints: Sequence[str],
    wants_to_wait: Callable[[], bool],
    keys: HostKeys | None = None,
    *,
    puts_apart: bool = False,
) -> ZenohBus | None:
    """Wait for the router until it is there or `wants_to_wait()`, asked all the time, says no.

    It is for services: the bus calls back directly (see `ZenohBus`, also on `puts_apart`).

    Raises:
        NotConnected: The endpoints cannot be used at all.
    """
    zenoh.init_log_from_env_or("off")
    os.environ.setdefault(*ONE_RECEIVER)  # read when this process opens its first session
    opening = _open_apart(lambda: client_config(endpoints, keys=keys))
    while not wait([opening], 0.05).done:
        if not wants_to_wait():
            return None
    try:
        session = opening.result()
    except zenoh.ZError as error:
        raise NotConnected(f"cannot connect to {', '.join(endpoints)}: {error}") from error
    return ZenohBus(session, calls_directly=True, puts_apart=puts_apart)


def _open_apart(
    config: Callable[[], zenoh.Config], timeout_s: float | None = None
) -> "Future[zenoh.Session]":
    """Open a session on a thread of its own; one that nobody wants any more is closed.

    Opening blocks inside Zenoh, where no signal reaches Python.

    Raises:
        NotConnected: Zenoh cannot work in this process.
    """
    if is_forked():
        raise NotConnected(FORKED)
    _opened_in.add(os.getpid())
    opening: Future[zenoh.Session] = Future()

    def run() -> None:
        try:
            session = zenoh.open(config())
        except BaseException as error:  # noqa: BLE001 - raised where it is waited for
            if opening.set_running_or_notify_cancel():
                opening.set_exception(error)
            return
        if opening.set_running_or_notify_cancel():
            opening.set_result(session)
        else:
            session.close()

    thread = threading.Thread(target=run, daemon=True)
    if timeout_s is not None:
        _opening[thread] = time.monotonic() + timeout_s
    thread.start()
    return opening


_opening: weakref.WeakKeyDictionary[threading.Thread, float] = weakref.WeakKeyDictionary()
"""Threads that open a session, and when they give up."""


@atexit.register
def _let_openings_end() -> None:
    """Wait for those that would end just as Python does."""
    for thread, end_s in list(_opening.items()):
        left_s = max(0.0, end_s - time.monotonic())
        if left_s < ENDING_S:
            thread.join(left_s + ENDING_S)


_known_threads = _KnownThreads()


def _handler(
    callback: Callable[[Any], object], on_end: Callable[[], object] | None, *, is_direct: bool
) -> "zenoh.handlers.Callback[Any]":
    """What the library hands over to: on the thread that received, or on one of its own."""
    if is_direct:
        callback = _known_threads(callback)
    return zenoh.handlers.Callback(callback, on_end, indirect=not is_direct)


def _wait_for(is_so: Callable[[], bool], timeout_s: float) -> None:
    """Wait, without a lock: a signal that closes the session again may interrupt it."""
    deadline_s = time.monotonic() + timeout_s
    while not is_so() and time.monotonic() < deadline_s:
        time.sleep(LOOK_S)


def _as_daemon(declare: Callable[[], T]) -> T:
    """Declare on a daemon thread.

    The thread that Zenoh starts for the callbacks is one, too, then. Python waits for all others
    before it ends, even before it closes the sessions that nobody has closed.
    """
    declared: Future[T] = Future()

    def run() -> None:
        try:
            declared.set_result(declare())
        except BaseException as error:  # noqa: BLE001 - raised where it is waited for
            declared.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return declared.result()


def _read(payload: zenoh.ZBytes) -> bytes:
    """The payload's bytes; one that is too large in any case is not copied, only its size kept."""
    return payload.to_bytes() if len(payload) <= LARGEST else bytes(LARGEST + 1)
