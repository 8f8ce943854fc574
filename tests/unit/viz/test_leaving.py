"""What is dragged and not let go of: the page goes, or says that it was not meant."""

import asyncio
import contextlib
import re
import socket
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import pytest
import viser
import zstandard
from support.waiting import wait_until
from viser._messages import Message, SceneNodeDragMessage, ViewerCameraMessage
from websockets.sync.client import ClientConnection, connect

from trolley_viz.features.driving.aiming import GOAL_HINT

if TYPE_CHECKING:
    from .conftest import Stage

from .features.zones.test_zones import MIRROR, ZoneKeeper

pytestmark = pytest.mark.drives

STEP_S = 0.5
"""A page that says nothing for three times as long is given up."""


def say(page: ClientConnection, message: Message) -> None:
    page.send(msgspec.msgpack.encode(message.as_serializable_dict()))


def shown(data: bytes) -> bytes:
    """Return what viser tells its page, beside arrays."""
    size = int.from_bytes(data[8:16], "little")
    return zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])


def drag(phase: Literal["start", "update", "end"], node: str, owner: str) -> Message:
    far = (1.0 if phase == "start" else 2.0, 1.0, 0.0)
    return SceneNodeDragMessage(
        phase=phase,
        name=node,
        instance_index=2,
        start_position=(1.0, 1.0, 0.0),
        start_screen_pos=(0.4, 0.5),
        end_position=far,
        end_screen_pos=(0.4 if phase == "start" else 0.6, 0.5),
        button="left",
        modifier=None,
        owner=owner,
    )


class Page:
    """A page with both of its connections, to viser's scene and its own line."""

    def __init__(self, stage: "Stage") -> None:
        self.stage = stage
        url = f"ws://127.0.0.1:{stage.config.viz.port}"
        protocol: Any = f"viser-v{viser.__version__}"
        self.line = connect(f"{url}/line?page=abc", max_queue=None)
        self.socket = connect(f"{url}/scene/", subprotocols=[protocol], max_size=None)
        self.socket.recv()
        say(
            self.socket,
            ViewerCameraMessage(
                wxyz=(1.0, 0.0, 0.0, 0.0),
                position=(0.0, -4.0, 8.0),
                fov=0.7,
                near=0.1,
                far=1000.0,
                image_height=400,
                image_width=400,
                look_at=(0.0, 0.0, 0.0),
                up_direction=(0.0, 0.0, 1.0),
            ),
        )
        self.wait(lambda: bool(stage.viz.pages.all))
        (self.page,) = stage.viz.pages.all
        self.line.send(f'{{"scene": "{self._secret()}"}}')
        self.wait(lambda: self.page.session.window.picture.client is not None)
        self.run(0.5)

    def run(self, seconds: float) -> None:
        """Let time pass, in which it answers beats."""
        for _ in range(max(1, round(seconds / STEP_S))):
            self.line.send('{"beat_ms": 0}')
            wait_until(self._is_heard, "the page is heard")
            self.stage.runtime.run(STEP_S)

    def wait(self, is_so: Callable[[], bool]) -> None:
        """Wait for what comes over a socket; for the viewer no time passes."""

        def look() -> bool:
            self.stage.runtime.run(0.0)
            return is_so()

        wait_until(look, "it is as it should be")

    def begin_drag(self, node: str) -> None:
        owner = self._owner
        for phase in ("start", "update"):
            say(self.socket, drag(phase, node, owner))

    def end_drag(self, node: str) -> None:
        say(self.socket, drag("end", node, self._owner))

    @property
    def _owner(self) -> Any:
        client = self.stage.session.window.picture.client
        assert client is not None
        return client.scene._owner_id

    def tell(self, **gesture: Any) -> None:
        said = {"gesture": {"at_ms": self.stage.now_ms, **gesture}}
        self.line.send(msgspec.json.encode(said).decode())

    def leave(self) -> None:
        """Go without a word."""
        for one in (self.line, self.socket):
            one.socket.shutdown(socket.SHUT_RDWR)
        self.wait(lambda: self.page.session.window.picture.client is None)
        self.stage.runtime.run(3.0)

    def _is_heard(self) -> bool:
        self.stage.runtime.run(0.0)
        return self.page._heard_ns == self.stage.viz.monotonic_ns

    def _secret(self) -> str:
        """By which it is known to be the same page's, as viser's page shows it."""

        def look() -> re.Match[bytes] | None:
            self.stage.runtime.run(0.0)
            with contextlib.suppress(TimeoutError):
                return re.search(rb'data-secret="(\w+)"', shown(self.socket.recv(0, decode=False)))
            return None

        found = wait_until(look, "viser's page has its secret")
        assert found is not None
        return found[1].decode()


@pytest.fixture
def page(stage: "Stage") -> Iterator[Page]:
    page = Page(stage)
    yield page
    for one in (page.line, page.socket):
        one.socket.close()


def test_no_goal_is_sent(page: Page, stage: "Stage") -> None:
    session = stage.session
    session.aiming.point_goal()
    page.begin_drag("/pointing")
    page.wait(lambda: session.pointing._arrow is not None)
    page.leave()
    assert session.pointing._arrow is None
    assert stage.robot.goals == []


def test_no_goal_is_sent_when_the_line_is_lost_before_it_is_let_go(
    page: Page, stage: "Stage"
) -> None:
    stage.session.aiming.point_goal()
    page.begin_drag("/pointing")
    page.wait(lambda: stage.session.pointing._arrow is not None)
    page.line.socket.shutdown(socket.SHUT_RDWR)
    page.wait(lambda: page.page._line is None)
    page.end_drag("/pointing")
    page.wait(lambda: stage.session.drags._end is not None)
    stage.runtime.run(3.0)
    assert stage.session.drags._end is None
    assert stage.robot.goals == []


@pytest.mark.parametrize("is_word_first", [True, False])
def test_a_goal_is_sent_when_it_is_let_go(
    page: Page, stage: "Stage", *, is_word_first: bool
) -> None:
    stage.session.aiming.point_goal()
    page.begin_drag("/pointing")
    page.wait(lambda: stage.session.pointing._arrow is not None)
    if is_word_first:
        page.tell(released=(0.6, 0.5))
        page.wait(lambda: stage.session.drags._released is not None)
        page.end_drag("/pointing")
    else:
        page.end_drag("/pointing")
        page.wait(lambda: stage.session.drags._end is not None)
        assert stage.robot.goals == []
        page.tell(released=(0.6, 0.5))
    page.wait(lambda: len(stage.robot.goals) == 1)


@pytest.mark.parametrize("is_word_first", [True, False])
def test_no_goal_is_sent_when_the_phone_takes_the_touch(
    page: Page, stage: "Stage", *, is_word_first: bool
) -> None:
    session = stage.session
    session.aiming.point_goal()
    page.begin_drag("/pointing")
    page.wait(lambda: session.pointing._arrow is not None)
    if is_word_first:
        page.tell(cancelled=True)
        page.wait(lambda: session.drags._cancelled_until_ns > 0)
        page.end_drag("/pointing")
    else:
        page.end_drag("/pointing")
        page.wait(lambda: session.drags._end is not None)
        page.tell(cancelled=True)
    page.wait(lambda: session.pointing._arrow is not None and not session.pointing._arrow.visible)
    assert session.aiming.hint == GOAL_HINT
    # A second finger that comes up is a click.
    click: Any = SimpleNamespace(ray_origin=(0, 0, 2), ray_direction=(1, 0, -1))
    click.screen_pos = (0.7, 0.6)
    assert session.pointing._plane is not None
    asyncio.run(session.pointing._plane._impl.click_cb[0].callback(click))  # type: ignore[arg-type]
    page.run(3.0)
    assert stage.robot.goals == []
    assert session.pointing.tool is not None  # for another try
    page.tell(released=(0.7, 0.6))
    page.wait(lambda: session.drags._released is not None)
    asyncio.run(session.pointing._plane._impl.click_cb[0].callback(click))  # type: ignore[arg-type]
    page.wait(lambda: len(stage.robot.goals) == 1)


def test_an_end_of_which_the_page_says_nothing_is_none(page: Page, stage: "Stage") -> None:
    session = stage.session
    session.aiming.point_goal()
    page.tell(released=(0.3, 0.5))  # something else was let go of, elsewhere
    page.begin_drag("/pointing")
    page.end_drag("/pointing")
    page.wait(lambda: session.drags._end is not None)
    page.run(3.0)
    assert session.drags._end is None
    page.tell(released=(0.6, 0.5))  # too late
    page.wait(lambda: session.drags._released is not None)
    page.run(0.5)
    assert stage.robot.goals == []


def test_no_zone_is_moved(page: Page, stage: "Stage") -> None:
    keeper = stage.runtime.add(ZoneKeeper())
    stage.runtime.run(0.5)
    editor = stage.session.drawing.zone_editor
    editor.select(MIRROR.name)
    page.begin_drag("/drawing/handles")
    page.wait(lambda: editor.sketch is not None and editor.sketch.points[0][0] > 1.5)
    page.leave()
    assert keeper[MIRROR.name] == MIRROR
