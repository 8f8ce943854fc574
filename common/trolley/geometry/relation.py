"""Where one frame is in another, how far and in which direction, and how old that is."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

from trolley.geometry.frames import BASE, LASER, MAP, ODOM, FrameTree, Link, MissingLink
from trolley.geometry.pose import Pose2D

STALE_AFTER_S = 1.0


@dataclasses.dataclass(frozen=True)
class Frames:
    """What is known of the frames at one moment."""

    tree: FrameTree
    heights: Mapping[str, float]
    """Height of each frame above its parent's ground plane [m]; a missing one is 0."""
    now_ns: int | None
    """Robot time, None without `base`."""


@dataclasses.dataclass(frozen=True)
class LinkAge:
    """One link of the chain between two frames."""

    parent: str
    child: str
    age: float | None
    """[s]; None for a mounting, and without robot time."""


@dataclasses.dataclass(frozen=True)
class Relation:
    """Where `child` is in `parent`."""

    parent: str
    child: str
    distance: float
    """On the floor [m]."""
    bearing: float
    """Bearing of the child as seen from the parent's origin, left positive [rad]; 0 at the origin.
    """
    translation: tuple[float, float, float]
    """[m]."""
    yaw: float
    """[rad]."""
    rotation: tuple[float, float, float, float]
    """The quaternion x, y, z, w."""
    age: float | None
    """Age of the oldest link [s], None where none has an age."""
    links: Sequence[LinkAge]
    stale: Sequence[str]
    """The links of the robot's own motion that are too old to rest anything on, in words."""


def relation(frames: Frames, parent: str, child: str) -> Relation:
    """Where `child` is in `parent`, and how old what that rests on is.

    Raises:
        MissingLink: The frames are not connected.
    """
    chain = frames.tree.chain(parent, child)
    pose = frames.tree.lookup(parent, child)
    links = [LinkAge(one.parent, one.child, _age_s(frames, one.stamp_ns)) for one in chain]
    ages = [one.age for one in links if one.age is not None]
    return Relation(
        parent=parent,
        child=child,
        distance=math.hypot(pose.x, pose.y),
        bearing=math.atan2(pose.y, pose.x) if pose.x or pose.y else 0.0,
        translation=(pose.x, pose.y, _height(frames, child) - _height(frames, parent)),
        yaw=pose.yaw,
        rotation=pose.as_quaternion(),
        age=max(ages, default=None),
        links=links,
        stale=_stale(frames, chain),
    )


def why_missing(frames: Frames, missing: MissingLink) -> str:
    """The tree's own words, and who should have published the link."""
    who = {ODOM: "localizer", BASE: "base", LASER: "base"}.get(missing.missing)
    hint = f"; {who} publishes it" if who and missing.missing != MAP else ""
    known = frames.tree.link(missing.missing)
    age_s = None if known is None else _age_s(frames, known.stamp_ns)
    age = "" if age_s is None else f"; its last link is {age_s:.1f} s old"
    return f"{missing}{hint}{age}"


def set_link(
    tree: FrameTree,
    parent: str,
    child: str,
    pose: Pose2D,
    stamp_ns: int | None,
    pose_stamp_ns: int | None,
) -> None:
    """Set the link that a `tf/<child>` tells of, with the stamp that its age counts from.

    An unchanged `tf/odom` is not old: how fresh it is says the pose that came with it
    (`pose_stamp_ns`). The lidar is screwed on.

    Raises:
        ValueError: The link has no name or would close a loop.
    """
    if child == ODOM and stamp_ns is not None and pose_stamp_ns is not None:
        stamp_ns = max(stamp_ns, pose_stamp_ns)
    tree.set(parent, child, pose, None if child == LASER else stamp_ns)


def _height(frames: Frames, frame: str) -> float:
    height = 0.0
    while (link := frames.tree.link(frame)) is not None:
        height += frames.heights.get(frame, 0.0)
        frame = link.parent
    return height


def _age_s(frames: Frames, stamp_ns: int | None) -> float | None:
    if stamp_ns is None or frames.now_ns is None:
        return None
    return max(0.0, (frames.now_ns - stamp_ns) * 1e-9)


def _stale(frames: Frames, chain: Sequence[Link]) -> list[str]:
    found: list[str] = []
    for link in chain:
        if link.child not in (ODOM, BASE):
            continue
        age_s = _age_s(frames, link.stamp_ns)
        if age_s is None:
            found.append(f"{link.parent} -> {link.child} has no age: base is not running")
        elif age_s > STALE_AFTER_S:
            found.append(f"{link.parent} -> {link.child} is {age_s:.1f} s old")
    return found
