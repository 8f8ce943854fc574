"""The frames as a tree: a switch for each one's axes, its parent, the age of the link."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol

from trolley.geometry.frames import BASE, LASER, FrameTree, Link, MissingLink
from trolley_viz.controls.controls import Check, Controls
from trolley_viz.controls.markup import note, table
from trolley_viz.robots.placement import Placement
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import age_text

MAX_TREE_FRAMES = 60
INDENT = "\u2003"
MAX_LETTERS = 64


@dataclass(frozen=True)
class Branch:
    """One frame of the tree."""

    frame: str
    depth: int
    link: Link | None
    """To its parent; None for a root."""


class Switch(Protocol):
    """Shows or hides the axes of a frame."""

    def __call__(self, frame: str, *, is_on: bool) -> None:
        """Show or hide them."""
        ...


class FrameTreePanel:
    """The tree with its switches; made again when frames come or go.

    Args:
        shown: the frames whose axes are shown.
        switch: shows or hides those of one.
    """

    def __init__(self, gui: Controls, shown: Callable[[], Collection[str]], switch: Switch) -> None:
        self._gui = gui
        self._shown_axes, self._switch = shown, switch
        self._inside = gui.add_folder()
        self._boxes: dict[tuple[str, int], Check] = {}
        self._links = gui.add_html("")

    def update(self, view: View) -> None:
        """Bring tree and ages up to date."""
        branches = tree(view.placement.tree)[:MAX_TREE_FRAMES]
        keys = [(one.frame, one.depth) for one in branches]
        if keys != list(self._boxes):
            self._build(keys, set(self._shown_axes()))
        rows = [
            (one.frame, one.link.parent, _where(one.link), link_age(one.link, view.robot_ns))
            for one in branches
            if one.link is not None
        ]
        lines = "".join(map(note, missing_links(view.placement)))
        self._links.content = table(rows, num_names=2) + lines

    def _build(self, keys: list[tuple[str, int]], on: set[str]) -> None:
        for box in self._boxes.values():
            box.remove()
        self._boxes.clear()
        with self._inside:
            for frame, depth in keys:
                label = INDENT * depth + frame[:MAX_LETTERS]
                box = self._gui.add_check(label, frame in on, is_name=True)
                box.on_change(lambda is_on, frame=frame: self._switch(frame, is_on=is_on))
                self._boxes[frame, depth] = box


def tree(frames: FrameTree) -> list[Branch]:
    """All frames, each below its parent and children by name."""
    children: dict[str, list[str]] = {}
    roots: list[str] = []
    for frame in frames.frames():
        link = frames.link(frame)
        (roots if link is None else children.setdefault(link.parent, [])).append(frame)
    found: list[Branch] = []
    open_ends = [(root, 0) for root in reversed(roots)]
    while open_ends:
        frame, depth = open_ends.pop()
        found.append(Branch(frame, depth, frames.link(frame)))
        open_ends += [(child, depth + 1) for child in reversed(children.get(frame, []))]
    return found


def missing_links(placement: Placement) -> list[str]:
    """What keeps frames from having a place in the world, each missing link named once."""
    said: dict[str, str] = {}
    for frame in (BASE, LASER, *placement.tree.frames()):
        try:
            placement.tree.lookup(placement.world, frame)
        except MissingLink as missing:
            said.setdefault(missing.missing, f"Missing: tf/{missing.missing}. {missing}")
    return list(said.values())


def link_age(link: Link, robot_ns: int | None) -> str:
    """Write how old a link is; nothing while the robot's clock is silent."""
    if link.stamp_ns is None:
        return "fixed"
    return "" if robot_ns is None else age_text((robot_ns - link.stamp_ns) * 1e-9)


def _where(link: Link) -> str:
    return f"{link.pose.x:.2f}, {link.pose.y:.2f}, {link.pose.yaw:.2f}"
