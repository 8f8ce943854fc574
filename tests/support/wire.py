"""Asking real services over a real bus."""

from support.waiting import PATIENCE_S, wait_until
from trolley.messages import ErrorReply, Health
from trolley.runtime import codec
from trolley.runtime.bus import Reply
from trolley.runtime.zenoh_bus import ZenohBus


def read(bus: ZenohBus, selector: str, payload: bytes = b"", encoding: str = "") -> list[Reply]:
    """Ask and wait for all answers."""
    replies: list[Reply] = []
    done: list[bool] = []
    bus.get(selector, payload, encoding, PATIENCE_S, replies.append, lambda: done.append(True))
    wait_until(lambda: done, lambda: f"the end of the answers to {selector}")
    return replies


def error_code(reply: Reply) -> str:
    assert reply.is_error
    return codec.decode(ErrorReply, reply.payload, reply.encoding).code


def health_of(bus: ZenohBus, service: str) -> Health | None:
    replies = read(bus, f"trolley/tester/health/{service}")
    found = [reply for reply in replies if not reply.is_error]
    return codec.decode(Health, found[0].payload, found[0].encoding) if found else None


def wait_for_service(bus: ZenohBus, service: str) -> Health:
    """Until the service answers, which it does once the clash rule is settled."""

    def healthy() -> Health | None:
        health = health_of(bus, service)
        return health if health is not None and health.state == "ok" else None

    found = wait_until(healthy, lambda: f"{service} is up")
    assert found is not None
    return found


def stored_names(bus: ZenohBus) -> set[str]:
    return {reply.key.rpartition("/")[2] for reply in read(bus, "trolley/tester/poses/*")}
