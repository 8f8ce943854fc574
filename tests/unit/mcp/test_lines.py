"""What comes on stdin, read ahead by a thread."""

import asyncio
import os
import threading
from collections.abc import Callable
from io import FileIO

import pytest

from trolley_mcp import lines
from trolley_mcp.lines import Lines, is_stop

CALL = b'{"method":"tools/call","params":{"name":"status"}}'
STOP = b'{"method":"tools/call","params":{"name":"stop"}}'
WAIT_S = 20.0


def read(data: bytes, stop: Callable[[], None] = lambda: None) -> list[str]:
    """All lines, in the order in which the session gets them."""
    near, far = os.pipe()

    def write() -> None:
        with FileIO(far, "wb") as out:
            left = memoryview(data)
            while left:
                left = left[out.write(left) :]

    async def collect() -> list[str]:
        return [line async for line in Lines(file, stop)]

    threading.Thread(target=write, daemon=True).start()
    with FileIO(near) as file:
        return asyncio.run(collect())


def test_a_stop_is_asked_for_behind_a_thousand_calls_while_the_session_is_busy() -> None:
    near, far = os.pipe()
    stopped, is_read = threading.Event(), threading.Event()
    flood = (CALL + b"\n") * 1000 + STOP + b"\n"

    def write() -> None:
        os.write(far, flood)
        os.close(far)

    threading.Thread(target=write, daemon=True).start()

    def stop() -> None:
        stopped.set()
        is_read.wait(WAIT_S)

    async def session() -> str:
        come = Lines(file, stop)
        assert stopped.wait(WAIT_S)  # the event loop does nothing meanwhile
        first = await anext(come)
        is_read.set()
        assert len([line async for line in come]) == 1000
        return first

    with FileIO(near) as file:
        assert asyncio.run(session()) == STOP.decode()


def test_lines_come_whole_and_in_their_order_however_they_are_cut() -> None:
    long = b'{"text":"' + b"\xc3\xa4" * 100_000 + b'"}'
    come = read(b"\n".join([b"1", long, b"", b"3"]))
    assert come == ["1", long.decode(), "", "3"]


def test_what_is_no_text_takes_no_line_with_it() -> None:
    assert read(b"\xff\xfe\n" + CALL + b"\n") == ["\ufffd\ufffd", CALL.decode()]


def test_who_sends_more_than_is_kept_waits_and_loses_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lines, "MOST_WAITING", 3)
    monkeypatch.setattr(lines, "CHUNK_BYTES", 7)
    sent = [str(number) for number in range(500)]
    assert read("\n".join(sent).encode()) == sent


@pytest.mark.parametrize(
    "line",
    [
        b"stop",
        b'{"method":"tools/list","params":{"name":"stop"}}',
        b'{"method":"tools/call","params":{"name":"stopping"}}',
        b'{"method":"tools/call","params":{"name":"note","arguments":{"text":"stop"}}}',
        b'{"method":"tools/call","params":"stop"}',
        b"[" * 5000 + b"stop",
    ],
)
def test_nothing_else_is_a_stop(line: bytes) -> None:
    assert is_stop(STOP)
    assert not is_stop(line)
