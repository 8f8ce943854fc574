"""`trolley tf PARENT CHILD`."""

import dataclasses
import math
import time
from typing import Any

import click

from trolley import codes, topics
from trolley.cli import exits
from trolley.cli.options import FloatRange, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import as_json as to_json
from trolley.cli.show import print_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.geometry import FrameTree, MissingLink
from trolley.geometry.frames import BASE, ODOM
from trolley.geometry.relation import Frames, Relation, relation, set_link, why_missing


def read_frames(robot: Robot) -> Frames:
    """Ask everybody for the links between frames."""
    tree = FrameTree()
    heights: dict[str, float] = {}
    now_ns = robot.connection.robot_now_ns(robot.name)  # first: late answers make nothing old
    odometry = robot.latest(topics.ODOM)
    if odometry is not None:
        tree.set(ODOM, BASE, odometry.pose, odometry.stamp_ns)
    estimate = robot.latest(topics.POSE)
    pose_stamp_ns = None if estimate is None else estimate.stamp_ns
    for (child,), link in robot.get(topics.TF).items():
        if child == BASE:
            continue
        try:
            set_link(tree, link.parent, child, link.pose, link.stamp_ns, pose_stamp_ns)
        except ValueError as error:  # anybody may publish a frame, also one that closes a loop
            say(f"tf/{child} is left out: {error}", err=True)
            continue
        heights[child] = link.z
    return Frames(tree, heights, now_ns)


def _plain(found: Relation) -> dict[str, Any]:
    return dataclasses.asdict(found)


def _print(found: Relation) -> None:
    x, y, z = found.translation
    qx, qy, qz, qw = found.rotation
    say(f"distance    {found.distance:.3f} m")
    say(f"bearing     {found.bearing:.3f} rad ({math.degrees(found.bearing):.1f}°)")
    say(f"translation {x:.3f} {y:.3f} {z:.3f} m")
    say(
        f"rotation    yaw {found.yaw:.3f} rad ({math.degrees(found.yaw):.1f}°), "
        f"quaternion {qx:.4f} {qy:.4f} {qz:.4f} {qw:.4f}"
    )
    say("age         " + ("-" if found.age is None else f"{found.age:.2f} s"))


@click.command(name="tf")
@click.argument("parent")
@click.argument("child")
@click.option("--follow", is_flag=True, help="Repeat until Ctrl-C.")
@click.option(
    "--period", type=FloatRange(min=0.05), default=0.5, help="Seconds between repetitions."
)
@where_options
@json_option
@reports_errors
def tf_command(parent: str, child: str, follow: bool, period: float, as_json: bool) -> None:
    """Show where frame CHILD is in frame PARENT: distance, bearing, translation, rotation, age.

    The exit code is 1 if the frames are not connected (the missing link is named) or a link of the
    robot's own motion is over 1 s old.
    """
    parent, child = parent.removeprefix("/"), child.removeprefix("/")
    with one_robot() as robot:
        while True:
            frames = read_frames(robot)
            try:
                found = relation(frames, parent, child)
            except MissingLink as missing:
                why = why_missing(frames, missing)
                raise Refused("missing_link", why, missing=missing.missing) from missing
            if not follow:
                break
            say(to_json(_plain(found), indent=None) if as_json else _line(found))
            time.sleep(period)
    if as_json:
        print_json(_plain(found))
    else:
        _print(found)
    if found.stale:
        say(f"{codes.STALE}: " + "; ".join(found.stale), err=True, fg="red")
        raise SystemExit(exits.FAILED)


def _line(found: Relation) -> str:
    x, y, _ = found.translation
    return (
        f"{found.distance:.3f} m  {math.degrees(found.bearing):6.1f}°  "
        f"x {x:.3f} y {y:.3f} yaw {found.yaw:.3f}  " + "; ".join(found.stale)
    )
