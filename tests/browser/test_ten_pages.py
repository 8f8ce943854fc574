"""Ten pages at one viewer, one of which stops reading: Stop works, and all others hear of it."""

import contextlib
import json
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
import viser
from playwright.sync_api import Page, expect
from support.waiting import PATIENCE_S, wait_until
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from trolley import topics

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

NUM_OTHERS = 9
SCENE = Subprotocol(f"viser-v{viser.__version__}")


class Other:
    """Both sockets of a page, without the browser around them.

    Args:
        port: the viewer's.
        number: tells the pages apart.
        reads: whether it takes what it is sent, once it is open.
    """

    def __init__(self, port: int, number: int, *, reads: bool) -> None:
        self.state: dict[str, Any] = {}
        url = f"ws://127.0.0.1:{port}"
        options: dict[str, Any] = {"max_queue": 1, "max_size": None, "open_timeout": PATIENCE_S}
        self._line = connect(f"{url}/line?page=other-{number}", **options)
        self._scene = connect(f"{url}/scene/", subprotocols=[SCENE], **options)
        listeners = (self._listen, self._look) if reads else ()
        self._threads = [threading.Thread(target=one, daemon=True) for one in listeners]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        for socket in (self._line, self._scene):
            socket.close()
        for thread in self._threads:
            thread.join()

    def _listen(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for words in self._line:
                told = json.loads(words)
                if "beat_ms" in told:
                    self._line.send(json.dumps({"beat_ms": told["beat_ms"]}))
                self.state = told.get("state", self.state)

    def _look(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for _ in self._scene:
                pass


@pytest.fixture
def others(shown: "Shown") -> Iterator[list[Other]]:
    """Nine pages besides the browser's; the last one does not read."""
    with contextlib.ExitStack() as opened:
        found: list[Other] = []
        for number in range(NUM_OTHERS):
            one = Other(shown.viz_port, number, reads=number < NUM_OTHERS - 1)
            found.append(opened.enter_context(contextlib.closing(one)))
        yield found


def test_stop_works_and_all_that_read_hear_of_it(
    page: Page, shown: "Shown", others: list[Other]
) -> None:
    readers = others[:-1]
    wait_until(lambda: all(one.state for one in readers), "all others are told how the robot is")
    page.get_by_role("button", name="kitchen").click()
    wait_until(
        lambda: all("kitchen" in str(one.state["sentence"]) for one in readers),
        "all others are told where it goes",
    )
    page.locator("#stop").click()
    expect(page.locator("#resume")).to_be_visible()
    wait_until(
        lambda: all(one.state["is_stopped"] for one in readers), "all others are told of the stop"
    )
    base = shown.robot.latest(topics.BASE)
    assert base is not None
    assert base.mode == "stopped"
    page.locator("#resume").click()
    wait_until(
        lambda: not any(one.state["is_stopped"] for one in readers),
        "all are told that it may drive",
    )
