"""The draft of a map while it is drawn aside."""

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley_viz.features.map_editing.drafting import Drafting
from trolley_viz.features.map_editing.preview import MapPreview
from trolley_viz.pointing.picture import Picture
from trolley_viz.robots.view import View

STORED = map_message(0, GridMap("room", 0.05, Pose2D(0.0, 0.0, 0.0), np.zeros((20, 30), np.int8)))


class Aside:
    """A worker that begins when it is told to."""

    now_ns = 0

    def __init__(self) -> None:
        self.waiting: list[Callable[[], None]] = []

    def work(self, fn: Callable[[], Any], done: Callable[[Any], None]) -> None:
        self.waiting.append(lambda: done(fn()))

    def finish(self) -> None:
        while self.waiting:
            self.waiting.pop(0)()


@pytest.fixture
def aside() -> Aside:
    return Aside()


@pytest.fixture
def drafting(aside: Aside) -> Drafting:
    preview = MapPreview(Picture())
    return Drafting(preview, lambda: cast(View, aside), lambda *_: None)


def test_a_map_published_again_while_it_is_drawn_changes_nothing(
    drafting: Drafting, aside: Aside
) -> None:
    drafting.begin(STORED)
    drafting.turn_to(math.radians(10.0))
    assert drafting.go_on_with(structs.replace(STORED))
    aside.finish()
    assert drafting.drawn is not None
    assert drafting.drawn.new_T_old.yaw == pytest.approx(math.radians(10.0))


def test_what_was_drawn_of_a_draft_that_is_over_does_not_count(
    drafting: Drafting, aside: Aside
) -> None:
    drafting.begin(STORED)
    drafting.turn_to(math.radians(10.0))
    drafting.begin(STORED)
    aside.finish()
    assert drafting.drawn is None


def test_a_draft_begun_while_another_is_drawn_is_drawn_too(
    drafting: Drafting, aside: Aside
) -> None:
    drafting.begin(STORED)
    drafting.turn_to(math.radians(10.0))
    drafting.begin(STORED)
    drafting.turn_to(math.radians(20.0))
    aside.finish()
    assert drafting.drawn is not None
    assert drafting.drawn.new_T_old.yaw == pytest.approx(math.radians(20.0))


def test_another_map_is_not_gone_on_with(drafting: Drafting) -> None:
    drafting.begin(STORED)
    assert not drafting.go_on_with(structs.replace(STORED, name="attic"))
    assert not drafting.go_on_with(None)
    assert drafting.go_on_with(STORED)
