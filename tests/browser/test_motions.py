"""Icons that move by themselves, as the pictures show that the page draws."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page

from trolley.geometry import Pose2D
from trolley.messages import Marker

from .seeing import Pixels, filmed, is_magenta, picture, pixel_of, poll

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

Motion = Literal["none", "jump", "jump_once", "rotate_x", "rotate_y", "rotate_z"]
SPOTS: dict[Motion, tuple[float, float]] = {
    "jump": (1.9, 0.4),
    "jump_once": (4.2, 0.1),
    "rotate_x": (5.6, 0.2),
    "rotate_y": (1.2, -1.6),
    "rotate_z": (4.5, -2.6),
}
"""Where icons stand [m], aside from the names that are written over the scene."""
TURNING: tuple[Motion, ...] = ("rotate_x", "rotate_y", "rotate_z")
SIZE_M = 0.7
AROUND = 56
"""Half of the part of the picture that holds one [px]."""
MOVED_PX, STILL_PX = 4, 1


def put(shown: "Shown", spot: Motion, motion: Motion, number: int = 0) -> None:
    """Put the icon of a spot; as each number is another icon, it begins anew."""
    x, y = SPOTS[spot]
    icon = Marker(
        kind="icon",
        icon="arrow-big-up-filled",
        pose=Pose2D(x, y, -math.pi / 2),
        z=0.5 + 1e-3 * number,
        size=(SIZE_M, SIZE_M, SIZE_M),
        color=(1.0, 0.0, 1.0, 1.0),
        motion=motion,
    )
    shown.robot.put_marker("motions", spot, icon)


def boxes(page: Page, frames: Sequence[Pixels], spot: Motion) -> NDArray[np.int64]:
    """What is seen of an icon: left, top, width, height [px], in each picture that shows it."""
    x, y = (round(part) for part in pixel_of(page, SPOTS[spot]))
    found: list[tuple[int, int, int, int]] = []
    for frame in frames:
        part = frame[y - AROUND : y + AROUND, x - AROUND : x + AROUND]
        rows, columns = is_magenta(part).nonzero()
        if len(rows):
            left, top = int(columns.min()), int(rows.min())
            found.append((left, top, int(np.ptp(columns)), int(np.ptp(rows))))
    return np.array(found, np.int64).reshape(-1, 4)


def moved(page: Page, frames: Sequence[Pixels], spot: Motion) -> NDArray[np.int64]:
    """By how much left, top, width and height differ among pictures [px]."""
    seen = boxes(page, frames, spot)
    return np.ptp(seen, axis=0) if len(seen) else np.zeros(4, np.int64)


def test_icons_jump_and_turn_until_they_are_told_to_stand(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    for spot in SPOTS:
        put(shown, spot, "none")
    poll(page, lambda: all(len(boxes(page, [picture(page)], spot)) for spot in SPOTS), "icons")
    with filmed(page) as frames:
        for spot in SPOTS:
            put(shown, spot, spot)
        for number in range(1, 6):  # one jump takes a second, as may a starved page to draw it
            page.wait_for_timeout(1500)
            if moved(page, frames, "jump_once")[1] > MOVED_PX:
                break
            put(shown, "jump_once", "jump_once", number)
        page.wait_for_timeout(1500)
        num_before = len(frames)
        late: list[Pixels] = []

        def all_move() -> bool:
            late[:] = frames[num_before:]
            turn = [moved(page, late, spot)[2:].max() for spot in TURNING]
            return min(moved(page, late, "jump")[1], *turn) > MOVED_PX

        poll(page, all_move, "they jump and turn")
    Image.fromarray(late[len(late) // 2].astype(np.uint8)).save(pictures / "motions.png")
    assert moved(page, frames, "jump_once")[1] > MOVED_PX
    assert moved(page, late, "jump_once").max() <= STILL_PX
    for spot in SPOTS:
        put(shown, spot, "none")
    page.wait_for_timeout(1500)
    with filmed(page) as frames:
        page.wait_for_timeout(1500)
    for spot in SPOTS:
        assert len(boxes(page, frames, spot)) > 0
        assert moved(page, frames, spot).max() <= STILL_PX
    shown.robot.delete_marker("motions", "jump")
    poll(page, lambda: not len(boxes(page, [picture(page)], "jump")), "one is deleted")
    assert len(boxes(page, [picture(page)], "rotate_x"))
    shown.robot.delete_marker()
