"""The frames of the shown robot with the saved places among them, as `place:<name>`."""

from collections.abc import Iterable

from trolley import topics
from trolley.geometry import FrameTree, MissingLink
from trolley.geometry.frames import BASE, MAP, ODOM
from trolley.geometry.relation import Frames, set_link, why_missing
from trolley_viz.robots.streams import Streams

PLACE = "place:"
"""The prefix of the name of a saved place where it is used as a frame."""


def why_nowhere(frames: Frames, missing: MissingLink) -> str:
    """Why two frames are not connected, in one sentence."""
    if missing.missing.startswith(PLACE):
        return f"There is no saved place “{missing.missing.removeprefix(PLACE)}” on this map."
    words = why_missing(frames, missing)
    return f"{words[0].upper()}{words[1:]}."


def frames_of(streams: Streams, robot_ns: int | None, wanted: Iterable[str] = ()) -> Frames:
    """What is known of the frames now.

    Args:
        streams: the robot's streams.
        robot_ns: robot time [ns], None while unknown.
        wanted: frames that somebody asks for; of the saved places only these are put in.
    """
    tree = FrameTree()
    heights: dict[str, float] = {}
    odometry, estimate = streams.latest(topics.ODOM), streams.latest(topics.POSE)
    if odometry is not None:
        tree.set(ODOM, BASE, odometry.pose, odometry.stamp_ns)
    pose_stamp_ns = None if estimate is None else estimate.stamp_ns
    for (child,), link in streams.by_parts(topics.TF).items():
        if child == BASE:
            continue
        try:
            set_link(tree, link.parent, child, link.pose, link.stamp_ns, pose_stamp_ns)
        except ValueError:  # a loop or a nameless frame: somebody else's mistake, left out
            continue
        heights[child] = link.z
    places, grid = streams.latest(topics.POSES), streams.latest(topics.MAP)
    named = {name.removeprefix(PLACE) for name in wanted if name.startswith(PLACE)}
    for place in [] if places is None else places.poses:
        if place.name in named and (grid is None or place.map == grid.name):
            tree.set(MAP, PLACE + place.name, place.pose)
    return Frames(tree, heights, robot_ns)
