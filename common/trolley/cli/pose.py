"""`trolley pose`: where the robot is, and the places that are saved."""

import math

import click

from trolley import codes, requests, topics
from trolley.cli import SuggestingGroup
from trolley.cli.options import (
    NumbersCommand,
    as_pose,
    json_option,
    pose_options,
    where_options,
)
from trolley.cli.printing import say
from trolley.cli.robots import known, one_robot, reports_errors
from trolley.cli.show import Progress, pose_text, print_json, print_table
from trolley.client import Robot
from trolley.codes import Refused
from trolley.messages import CapturedPose, PoseEstimate, SavedPose, request_params
from trolley.zones import room_at


@click.group(
    name="pose",
    cls=SuggestingGroup,
    invoke_without_command=True,
    sections={"Where the robot is": ("set", "find"), "Saved places": ("list", "save", "delete")},
)
@where_options
@json_option
@click.pass_context
@reports_errors
def pose_command(ctx: click.Context, as_json: bool) -> None:
    """Show where the robot is; with a subcommand, set its pose or manage saved places.

    Refused, with a reason, if the robot is lost or its pose is too old.
    """
    if ctx.invoked_subcommand is not None:
        return
    with one_robot() as robot:
        found = _where_is(robot)
        zones = None if as_json else robot.latest(topics.ZONES)
    if as_json:
        print_json(found)
        return
    assert found.pose is not None
    room = None if zones is None else room_at(zones.zones, found.pose.x, found.pose.y)
    say(f"{pose_text(found.pose)}  on {found.map}" + (f", in {room}" if room else ""))
    say(f"{found.state}, {found.match:.0%} of the beams fit the map{_deviation(found)}")


def _where_is(robot: Robot) -> CapturedPose | PoseEstimate:
    try:
        return robot.capture()
    except Refused as refused:
        if refused.code != codes.NOT_READY or "service" not in refused.details:
            raise
    # Without the tour service nobody judges the pose for us.
    estimate = robot.pose()
    if estimate.pose is None or estimate.state in ("lost", "searching"):
        raise Refused(codes.LOST, estimate.message or None, state=estimate.state)
    return estimate


def _deviation(found: CapturedPose | PoseEstimate) -> str:
    if found.covariance is None:
        return ""
    xy = math.sqrt(max(found.covariance[0], 0.0) + max(found.covariance[4], 0.0))
    yaw_deg = math.degrees(math.sqrt(max(found.covariance[8], 0.0)))
    return f", ± {xy:.2f} m, ± {yaw_deg:.0f}°"


@pose_command.command(name="set", cls=NumbersCommand)
@pose_options
@where_options
@json_option
@reports_errors
def set_pose(where: tuple[str, ...], deg: bool, as_json: bool) -> None:
    """Tell the robot where it is, roughly: metres on the map, YAW in radians."""
    pose = as_pose(where, deg=deg)
    with one_robot() as robot:
        estimate = robot.ask(requests.POSE_SET, request_params.SetPose(pose=pose))
    if as_json:
        print_json(estimate)
    else:
        say(f"{estimate.state} at {pose_text(estimate.pose or pose)}")


@pose_command.command(name="find")
@where_options
@json_option
@reports_errors
def find_pose(as_json: bool) -> None:
    """Let the robot search the whole map for its pose, and wait for the result."""
    progress = Progress()
    with one_robot() as robot:
        progress.show("searching the whole map ...")
        try:
            found = robot.find()
        finally:
            progress.clear()
    if as_json:
        print_json(found)
    elif found.pose is not None:
        why = f": {found.message}" if found.message else ""
        say(f"{found.state} at {pose_text(found.pose)}{why}")


@pose_command.command(name="save")
@click.argument("name")
@click.option("--replace", is_flag=True, help="Overwrite an existing place of that name.")
@click.option("--icon", default="", help="Its icon in the viewer.")
@where_options
@json_option
@reports_errors
def save_pose(name: str, replace: bool, icon: str, as_json: bool) -> None:
    """Save the place where the robot stands as NAME."""
    with one_robot() as robot:
        saved = robot.capture(name, icon=icon, replace=replace)
    if as_json:
        print_json(saved)
    else:
        say(f"saved {saved.name}: {pose_text(saved.pose)}")


@pose_command.command(name="list")
@where_options
@json_option
@reports_errors
def list_poses(as_json: bool) -> None:
    """List the saved places."""
    with one_robot() as robot:
        saved = known(robot, topics.POSES, "The tour service is still starting.")
    if as_json:
        print_json(saved.poses)
    elif not saved.poses:
        say("No places are saved yet; save one with `trolley pose save NAME`.")
    else:
        print_table(("NAME", "MAP", "X", "Y", "YAW", "SAVED"), [_row(pose) for pose in saved.poses])


def _row(saved: SavedPose) -> tuple[str, ...]:
    pose = saved.pose
    numbers = (f"{pose.x:.3f}", f"{pose.y:.3f}", f"{pose.yaw:.3f}")
    return (saved.name, saved.map, *numbers, saved.saved_at or "")


@pose_command.command(name="delete")
@click.argument("name")
@where_options
@json_option
@reports_errors
def delete_pose(name: str, as_json: bool) -> None:
    """Delete the saved place NAME."""
    with one_robot() as robot:
        deleted = robot.ask(requests.POSES_DELETE, request_params.Named(name=name))
    if as_json:
        print_json(deleted)
    else:
        say(f"deleted {name}")
