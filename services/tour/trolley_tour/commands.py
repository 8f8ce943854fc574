"""`trolley tour import`: turns the goal list of a ROS script into saved poses and a tour."""

import sys
from pathlib import Path

import click

from trolley import codes, requests, topics
from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import known, one_robot, reports_errors
from trolley.cli.show import pose_text, print_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.files import read_text
from trolley.geometry import angle_difference
from trolley.messages import SavedPose, Tour
from trolley.names import name_problem
from trolley_tour.goal_points import GoalPoint, GoalPointsError, read_goal_points, tour_of

STANDARD_INPUT = Path("-")
STARTING = "The tour service is still starting."
SAME_M, SAME_RAD = 0.01, 0.01
"""A saved pose this near to an imported one is the same place."""


@click.command(name="import")
@click.argument("file", type=click.Path(allow_dash=True, path_type=Path))
@click.option("--name", help="What to call the tour; else the file's name.")
@click.option(
    "--map", "map_name", default="", help="The places' map; else the robot's current one."
)
@click.option("--replace", is_flag=True, help="Overwrite a tour and places of these names.")
@click.option("--dry-run", is_flag=True, help="Show what would be saved, and save nothing.")
@where_options
@json_option
@reports_errors
def import_tour(
    file: Path, name: str | None, map_name: str, replace: bool, dry_run: bool, as_json: bool
) -> None:
    """Save the GoalPoints list of FILE ("-": standard input) as places and a tour.

    FILE is a Python script with a list `GoalPoints = [[(x, y, z), (x, y, z, w)], ...]`, or the list
    alone; it is only read, never run. The comment after a goal is its name.
    """
    try:
        points = read_goal_points(_text(file))
    except UnicodeDecodeError as error:
        raise click.ClickException(f"{file} is not UTF-8 text") from error
    except OSError as error:
        raise click.ClickException(f"{file} cannot be read: {error.strerror}") from error
    except GoalPointsError as error:
        raise click.ClickException(str(error)) from error
    tour = tour_of(points, name or ("imported" if file == STANDARD_INPUT else file.stem))
    problem = name_problem(tour.name)
    if problem is not None:
        raise click.BadParameter(f"{problem} (give another with --name)", param_hint="--name")
    poses = [SavedPose(name=point.name, map=map_name, pose=point.pose) for point in points]
    if not dry_run:
        with one_robot() as robot:
            if not replace:
                _refuse_taken(robot, points, tour)
            poses = [robot.ask(requests.POSES_PUT, pose) for pose in poses]
            tour = robot.ask(requests.TOURS_PUT, tour)
    if as_json:
        print_json({"tour": tour, "poses": poses})
        return
    for number, pose in enumerate(poses, start=1):
        say(f"{number:>3}  {pose.name}  {pose_text(pose.pose)}")
    on_map = f" on the map {poses[0].map}" if poses[0].map else ""
    verb = "would be saved" if dry_run else "is saved"
    say(f"The tour {tour.name} with {len(poses)} stops{on_map} {verb}.")


def _text(file: Path) -> str:
    if file == STANDARD_INPUT:
        return sys.stdin.buffer.read().decode("utf-8")
    return read_text(file)


def _refuse_taken(robot: Robot, points: list[GoalPoint], tour: Tour) -> None:
    """Refuse to overwrite other places, or a tour, of these names."""
    saved, tours = known(robot, topics.POSES, STARTING), known(robot, topics.TOURS, STARTING)
    places = {pose.name: pose.pose for pose in saved.poses}
    taken = [
        point.name
        for point in points
        if (pose := places.get(point.name)) is not None
        and (
            pose.distance_to(point.pose) > SAME_M
            or abs(angle_difference(pose.yaw, point.pose.yaw)) > SAME_RAD
        )
    ]
    if taken:
        names = ", ".join(taken)
        message = f"Other places are called {names}; add --replace to overwrite them."
        raise Refused(codes.EXISTS, message, names=taken)
    if any(other.name == tour.name for other in tours.tours):
        message = f"A tour {tour.name!r} exists already; add --replace, or --name NAME."
        raise Refused(codes.EXISTS, message, names=[tour.name])
