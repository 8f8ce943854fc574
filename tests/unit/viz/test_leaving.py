"""A browser whose connection is lost while something is dragged: nobody let go of it."""

import socket
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import pytest
import viser
from viser._messages import Message, SceneNodeDragMessage, ViewerCameraMessage
from websockets.sync.client import ClientConnection, connect

if TYPE_CHECKING:
    from .conftest import Stage

from .test_zones import MIRROR, ZoneKeeper


def say(page: ClientConnection, message: Message) -> None:
    page.send(msgspec.msgpack.encode(message.as_serializable_dict()))


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
    """A page that speaks viser's protocol."""

    def __init__(self, stage: "Stage") -> None:
        self.stage = stage
        protocol: Any = f"viser-v{viser.__version__}"
        url = f"ws://127.0.0.1:{stage.config.viz.port}"
        self.socket = connect(url, subprotocols=[protocol], max_size=None)
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
        self.wait(lambda: bool(stage.viz._sessions))
        stage.runtime.run(0.5)

    def wait(self, is_so: Callable[[], bool]) -> None:
        end_s = time.monotonic() + 10.0
        while not is_so():
            assert time.monotonic() < end_s
            time.sleep(0.01)
            self.stage.runtime.run(0.05)

    def begin_drag(self, node: str) -> None:
        owner = self.stage.session.client.scene._owner_id
        for phase in ("start", "update"):
            say(self.socket, drag(phase, node, owner))  # type: ignore[arg-type]

    def leave(self) -> None:
        self.socket.socket.shutdown(socket.SHUT_RDWR)
        self.wait(lambda: not self.stage.viz._sessions)
        self.stage.runtime.run(0.5)


@pytest.fixture
def page(stage: "Stage") -> Iterator[Page]:
    page = Page(stage)
    yield page
    page.socket.socket.close()


def test_no_goal_is_sent(page: Page, stage: "Stage") -> None:
    session = stage.session
    session.aiming.point_goal()
    page.begin_drag("/pointing")
    page.wait(lambda: session.pointing._arrow is not None)
    page.leave()
    assert stage.robot.goals == []


def test_a_goal_is_sent_when_it_is_let_go(page: Page, stage: "Stage") -> None:
    session = stage.session
    session.aiming.point_goal()
    page.begin_drag("/pointing")
    say(page.socket, drag("end", "/pointing", session.client.scene._owner_id))
    page.wait(lambda: len(stage.robot.goals) == 1)


def test_no_zone_is_moved(page: Page, stage: "Stage") -> None:
    keeper = stage.runtime.add(ZoneKeeper())
    stage.runtime.run(0.5)
    editor = stage.session.zones
    editor.select(MIRROR.name)
    page.begin_drag("/drawing/handles")
    page.wait(lambda: editor.sketch is not None and editor.sketch.points[0][0] > 1.5)
    page.leave()
    assert keeper[MIRROR.name] == MIRROR
