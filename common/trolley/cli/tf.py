"""`trolley tf PARENT CHILD`."""

import dataclasses
import math
import time
from typing import Any

import click

from trolley import codes, topics
from trolley.cli import exits
from trolley.cli.options import json_option, where_options
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import as_json as to_json
from trolley.cli.show import print_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.geometry import FrameTree, MissingLink, Pose2D
from trolley.geometry.frames import BASE, LASER, MAP, ODOM

STALE_AFTER_S = 1.0


@dataclasses.dataclass(frozen=True)
class Frames:
    """What is known of the frames at one moment."""

    tree: FrameTree
    heights: dict[str, float]
    """Height of each frame above its parent's ground plane [m]."""
    now_ns: int | None
    """Robot time, None without `base`."""


def read_frames(robot: Robot) -> Frames:
    """Ask everybody for the links between frames."""
    tree = FrameTree()
    heights: dict[str, float] = {}
    odometry = robot.latest(topics.ODOM)
    if odometry is not None:
        tree.set(ODOM, BASE, odometry.pose, odometry.stamp_ns)
    # An unchanged tf/odom is not old: how fresh it is says the pose that came with it.
    estimate = robot.latest(topics.POSE)
    for (child,), link in robot.get(topics.TF).items():
        stamp_ns: int | None = link.stamp_ns
        if child == BASE:
            continue
        if child == ODOM and estimate is not None:
            stamp_ns = max(link.stamp_ns, estimate.stamp_ns)
        if child == LASER:  # screwed on
            stamp_ns = None
        _set(tree, heights, link.parent, child, link.pose, link.z, stamp_ns)
    return Frames(tree, heights, robot.connection.robot_now_ns(robot.name))


def _set(
    tree: FrameTree,
    heights: dict[str, float],
    parent: str,
    child: str,
    pose: Pose2D,
    z: float,
    stamp_ns: int | None,
) -> None:
    try:
        tree.set(parent, child, pose, stamp_ns)
    except ValueError as error:  # anybody may publish a frame, also one that closes a loop
        click.echo(f"tf/{child} is left out: {error}", err=True)
        return
    heights[child] = z


def _height(frames: Frames, frame: str) -> float:
    height = 0.0
    while (link := frames.tree.link(frame)) is not None:
        height += frames.heights.get(frame, 0.0)
        frame = link.parent
    return height


def relation(frames: Frames, parent: str, child: str) -> dict[str, Any]:
    """Where `child` is in `parent`, and how old what that rests on is.

    Raises:
        MissingLink: The frames are not connected.
    """
    chain = frames.tree.chain(parent, child)
    pose = frames.tree.lookup(parent, child)
    links = [
        {"parent": link.parent, "child": link.child, "age": _age_s(frames, link.stamp_ns)}
        for link in chain
    ]
    ages = [link["age"] for link in links if isinstance(link["age"], float)]
    return {
        "parent": parent,
        "child": child,
        "distance": math.hypot(pose.x, pose.y),
        "bearing": math.atan2(pose.y, pose.x) if pose.x or pose.y else 0.0,
        "translation": [pose.x, pose.y, _height(frames, child) - _height(frames, parent)],
        "yaw": pose.yaw,
        "rotation": list(pose.as_quaternion()),
        "age": max(ages, default=None),
        "links": links,
        "stale": _stale(frames, chain),
    }


def _age_s(frames: Frames, stamp_ns: int | None) -> float | None:
    if stamp_ns is None or frames.now_ns is None:
        return None
    return max(0.0, (frames.now_ns - stamp_ns) * 1e-9)


def _stale(frames: Frames, chain: list[Any]) -> list[str]:
    """The links of the robot's own motion that are too old to rest anything on."""
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


def _why_missing(frames: Frames, missing: MissingLink) -> str:
    """The tree's own words, and who should have published the link."""
    who = {ODOM: "localizer", BASE: "base", LASER: "base"}.get(missing.missing)
    hint = f"; {who} publishes it" if who and missing.missing != MAP else ""
    known = frames.tree.link(missing.missing)
    age_s = None if known is None else _age_s(frames, known.stamp_ns)
    age = "" if age_s is None else f"; its last link is {age_s:.1f} s old"
    return f"{missing}{hint}{age}"


def _print(found: dict[str, Any]) -> None:
    x, y, z = found["translation"]
    qx, qy, qz, qw = found["rotation"]
    degrees = math.degrees(found["bearing"])
    click.echo(f"distance    {found['distance']:.3f} m")
    click.echo(f"bearing     {found['bearing']:.3f} rad ({degrees:.1f}°)")
    click.echo(f"translation {x:.3f} {y:.3f} {z:.3f} m")
    click.echo(
        f"rotation    yaw {found['yaw']:.3f} rad ({math.degrees(found['yaw']):.1f}°), "
        f"quaternion {qx:.4f} {qy:.4f} {qz:.4f} {qw:.4f}"
    )
    click.echo("age         " + ("-" if found["age"] is None else f"{found['age']:.2f} s"))


@click.command(name="tf")
@click.argument("parent")
@click.argument("child")
@click.option("--follow", is_flag=True, help="Print it again and again until Ctrl-C.")
@click.option("--period", type=click.FloatRange(min=0.05), default=0.5, help="Seconds between.")
@where_options
@json_option
@reports_errors
def tf_command(parent: str, child: str, follow: bool, period: float, as_json: bool) -> None:
    """Say where frame CHILD is in frame PARENT: distance, bearing, translation, rotation, age.

    Exit code 1 where the frames are not connected (the missing link is named) or a link of the
    robot's own motion is over 1 s old.
    """
    parent, child = parent.removeprefix("/"), child.removeprefix("/")
    with one_robot() as robot:
        while True:
            frames = read_frames(robot)
            try:
                found = relation(frames, parent, child)
            except MissingLink as missing:
                why = _why_missing(frames, missing)
                raise Refused("missing_link", why, missing=missing.missing) from missing
            if not follow:
                break
            click.echo(to_json(found, indent=None) if as_json else _line(found))
            time.sleep(period)
    if as_json:
        print_json(found)
    else:
        _print(found)
    if found["stale"]:
        click.secho(f"{codes.STALE}: " + "; ".join(found["stale"]), err=True, fg="red")
        raise SystemExit(exits.FAILED)


def _line(found: dict[str, Any]) -> str:
    x, y, _ = found["translation"]
    return (
        f"{found['distance']:.3f} m  {math.degrees(found['bearing']):6.1f}°  "
        f"x {x:.3f} y {y:.3f} yaw {found['yaw']:.3f}  " + "; ".join(found["stale"])
    )
