"""`Service.call_soon`: how another thread, such as a web server's, reaches a service."""

import threading

from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service


class Listener(Service):
    """Notes what it is called with, and on which thread."""

    name = "listener"

    def __init__(self) -> None:
        self.heard: list[tuple[str, int]] = []

    def hear(self, word: str) -> None:
        self.heard.append((word, threading.get_ident()))


def call_from_a_thread(listener: Listener, *words: tuple[str, bool]) -> None:
    def talk() -> None:
        for word, urgent in words:
            listener.call_soon(lambda word=word: listener.hear(word), urgent=urgent)

    thread = threading.Thread(target=talk)
    thread.start()
    thread.join()


def test_calls_run_in_order_on_the_thread_of_the_service() -> None:
    with Lockstep() as runtime:
        listener = runtime.add(Listener())
        call_from_a_thread(listener, ("a", False), ("b", False), ("c", False))
        assert listener.heard == []
        runtime.run(0.1)
        me = threading.get_ident()
        assert listener.heard == [("a", me), ("b", me), ("c", me)]


def test_an_urgent_call_goes_first() -> None:
    with Lockstep() as runtime:
        listener = runtime.add(Listener())
        call_from_a_thread(listener, ("drive", False), ("stop", True))
        runtime.run(0.1)
        assert [word for word, _ in listener.heard] == ["stop", "drive"]
