"""The page in Firefox and in WebKit, Safari's engine: what must never fail there."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from support.engines import Engine, engine, missing
from support.waiting import wait_until

from trolley_viz.controls.controls import Controls

from .test_holding import grips, tell_pad
from .test_page_itself import num_stops

if TYPE_CHECKING:
    from .viewer import Viewer

pytestmark = pytest.mark.browser

ALT, ARROW_LEFT = "\ue00a", "\ue012"
"""As WebDriver names keys."""


@pytest.fixture(params=["Firefox", "WebKit"])
def other(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    if needed := missing(request.param):
        pytest.skip(f"{needed}: not installed")
    with engine(request.param, tmp_path) as browser:
        yield browser


def test_stop_the_joystick_and_a_card_work_in_other_engines(
    other: Engine, viewer: "Viewer"
) -> None:
    other.open(viewer.url)
    wait_until(lambda: bool(viewer.lines), "the page calls")
    controls = Controls()
    with controls.add_tiles():
        for i in range(9):
            controls.add_button(f"place {i}", colour="purple")
    card = controls.add_card()
    with card:
        controls.add_button("Go", colour="green")
    viewer.greet()
    viewer.tell_controls(controls)
    tell_pad(viewer, is_mine=False)
    wait_until(lambda: other.ask("document.body.dataset.line") == "open", "it is connected")

    other.press("#stop")
    wait_until(lambda: num_stops(viewer) == 1, "Stop counts before it is let go")
    other.let_go()

    other.press(".hand-open")
    other.let_go()
    other.press(".hand-pad", (-30, 0), (-60, 0))
    wait_until(lambda: grips(viewer) and grips(viewer)[-1].x < -0.5, "the pad is held to the left")
    other.let_go()
    wait_until(lambda: not grips(viewer)[-1].held, "it is let go")
    other.act("key", {"type": "keyDown", "value": ARROW_LEFT})
    wait_until(lambda: grips(viewer)[-1].x == -1.0, "an arrow key drives")
    other.act("key", {"type": "keyDown", "value": ALT}, {"type": "keyUp", "value": ALT})
    wait_until(lambda: not grips(viewer)[-1].held, "any other key lets go of it")
    other.act("key", {"type": "keyUp", "value": ARROW_LEFT})

    card.visible = True
    viewer.tell_controls(controls)
    wait_until(lambda: other.ask("document.querySelector('.card') !== null"), "the card is there")
    wait_until(lambda: is_green(beside_word(other, ".card .button")), "the card is seen")
    assert num_stops(viewer) == 1


def beside_word(other: Engine, button: str) -> NDArray[np.int64]:
    """The colour of a button, which may not have come to its place yet."""
    x, y = other.middle(button)
    return other.picture()[y, x + 60]


def is_green(pixel: NDArray[np.int64]) -> bool:
    red, green, blue = pixel
    return bool(green > red + 40 and green > blue + 40)
