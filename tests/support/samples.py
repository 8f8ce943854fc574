"""Small valid messages."""

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    Clock,
    GoalStatus,
    Odometry,
    PoseEstimate,
    Robot,
    SavedPose,
    SavedPoses,
    Scan,
    Transform,
)


def make_clock(stamp_ns: int, epoch: int = 0, rate: float = 1.0) -> Clock:
    """Robot time."""
    return Clock(stamp_ns=stamp_ns, rate=rate, epoch=epoch)


def make_robot(name: str = "one") -> Robot:
    """A small robot that is driven by two wheels."""
    return Robot(
        stamp_ns=0,
        name=name,
        title=name,
        footprint=[(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1)],
        drive="differential",
        max_speed=0.5,
        max_wz=1.0,
        deceleration=1.0,
    )


def make_odometry(stamp_ns: int, x: float = 0.0) -> Odometry:
    """A robot that stands at x [m]."""
    return Odometry(stamp_ns=stamp_ns, pose=Pose2D(x, 0.0, 0.0), twist=Twist2D.zero())


def make_scan(stamp_ns: int, beams: int = 4) -> Scan:
    """A scan whose beams saw nothing valid."""
    return Scan(
        stamp_ns=stamp_ns,
        frame="laser",
        angle_min=0.0,
        angle_increment=0.1,
        time_increment=0.0,
        range_min=0.1,
        range_max=10.0,
        ranges=memoryview(bytes(4 * beams)),
    )


def make_transform(stamp_ns: int, child: str, parent: str = "map") -> Transform:
    """A transform that changes nothing."""
    return Transform(stamp_ns=stamp_ns, parent=parent, child=child, pose=Pose2D.identity())


def make_place(name: str = "", x: float = 0.0) -> SavedPose:
    """A saved pose at x [m] on the map `home`."""
    return SavedPose(name=name, map="home", pose=Pose2D(x, 0.0, 0.0))


def make_places(stamp_ns: int, *names: str) -> SavedPoses:
    """The list of saved poses."""
    return SavedPoses(stamp_ns=stamp_ns, poses=[make_place(name) for name in names])


def make_goal(stamp_ns: int, goal_id: str | None = None, state: str = "idle") -> GoalStatus:
    """The status of a goal."""
    return GoalStatus(stamp_ns=stamp_ns, id=goal_id, state=state)  # pyrefly: ignore[bad-argument-type]


def make_estimate(stamp_ns: int, state: str = "localized") -> PoseEstimate:
    """A pose at the origin of the map `home`."""
    return PoseEstimate(
        stamp_ns=stamp_ns,
        map="home",
        pose=Pose2D.identity(),
        covariance=[0.0] * 9,
        state=state,  # pyrefly: ignore[bad-argument-type]
        match=1.0,
        spread=0.0,
    )
