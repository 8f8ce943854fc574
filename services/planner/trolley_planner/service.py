"""The planner as a service: goals and senses in, velocities, path and costmap out."""

from collections.abc import Callable
from typing import TypeVar

from trolley import requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    GoalStatus,
    OccupancyGrid,
    Odometry,
    Path,
    PoseEstimate,
    Robot,
    SavedPoses,
    Scan,
    Suspects,
    Transform,
    VelocityCommand,
    Zones,
)
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley.runtime.service import Later, Service, answers, every, gets, on
from trolley_planner.navigator import OWN_SOURCE, Navigator
from trolley_planner.warmup import warm_up

R = TypeVar("R")
VALID_S = 0.15
"""A command is good for so long: three periods of commands, and short enough that with the way to
brake from full speed a robot whose planner dies stands within half a second."""
STATUS_S = 0.2
COSTMAP_S = 0.5
IDLE_COSTMAP_S = 2.0
TRAJECTORY_S = 0.1
ODOMETRY_S = 2.0
MAX_SCAN_PERIOD_NS = 200_000_000
WAIT_SHARE = 0.4


class PlannerService(Service):
    """Owns the costmap, the path, the trajectory and the current goal."""

    name = "planner"

    def __init__(self, config: RobotConfig) -> None:
        self._config = config.planner
        self._navigator = Navigator(config.planner)
        # Odometry comes on a raster of its own: a little early is better than a whole period late.
        self._command_ns = round(0.8e9 / config.planner.control_rate_hz)
        self._commanded_ns = 0
        self._scan_ns = 0
        self._scan_period_ns = 0
        self._trajectory_ns = 0
        self._costmap_ns = 0
        self._path_key = ""

    def prepare(self) -> None:
        """Compile the kernels."""
        warm_up()

    def start(self) -> None:
        """Watch what is sensed, and say that there is no goal."""
        self._odometry = self.watch(topics.ODOM, seconds=ODOMETRY_S, then=self._take_odometry)
        if self._config.frame == "map":
            self._watch_others()
        self.publish(topics.GOAL, self._navigator.status(self.stamp_ns))

    def epoch_began(self) -> None:
        """Stop: the base began anew."""
        self._navigator.begin_epoch(self.stamp_ns)
        self._publish_changes()

    # What is sensed.

    @on(topics.ROBOT)
    def take_robot(self, robot: Robot) -> None:
        """Take the footprint and the limits."""
        self._navigator.senses.robot = robot

    @on(topics.MAP)
    def take_map(self, grid: OccupancyGrid) -> None:
        """Take the map."""
        self._navigator.senses.map = grid

    @on(topics.ZONES)
    def take_zones(self, zones: Zones) -> None:
        """Take the zones."""
        self._navigator.senses.zones = zones

    @on(topics.SUSPECTS)
    def take_suspects(self, suspects: Suspects) -> None:
        """Take where mirrors are suspected."""
        self._navigator.senses.suspects = suspects

    @on(topics.POSES)
    def take_places(self, places: SavedPoses) -> None:
        """Take the saved places that goals may name."""
        self._navigator.senses.places = places

    @on(topics.TF, "laser")
    def take_mounting(self, transform: Transform, *_: str) -> None:
        """Take where the lidar sits."""
        self._navigator.senses.base_T_laser = transform.pose

    @on(topics.TF, "odom")
    def take_correction(self, transform: Transform, *_: str) -> None:
        """Take the newest correction of the odometry."""
        self._navigator.senses.take_correction(transform)

    @on(topics.POSE)
    def take_pose(self, pose: PoseEstimate) -> None:
        """Take what the localizer says of itself."""
        self._navigator.senses.pose = pose

    @on(topics.BASE)
    def take_base(self, base: BaseState) -> None:
        """Take what the base does: a stop or somebody else's hand pauses the goal."""
        self._navigator.take_base(base, self.stamp_ns)
        self._publish_changes()

    @on(topics.SCAN)
    def take_scan(self, scan: Scan) -> None:
        """Take a scan and answer it with a command; a lidar may be faster than commands are."""
        now_ns = self.now_ns
        if now_ns is None or 0 <= now_ns - self._scan_ns < self._command_ns:
            return
        self._scan_period_ns = min(now_ns - self._scan_ns, MAX_SCAN_PERIOD_NS)
        self._scan_ns = now_ns
        self._navigator.meet(now_ns, self.monotonic_ns)
        if self._navigator.take_scan(scan, list(self._odometry.history), now_ns):
            self._command(now_ns, scan.stamp_ns)
        self._navigator.maintain(now_ns)
        self._publish_changes()

    def _take_odometry(self, odometry: Odometry) -> None:
        self._navigator.senses.odometry = odometry
        now_ns = self.now_ns
        if now_ns is None or now_ns - self._commanded_ns < self._command_ns:
            return
        # Just before a scan is due its command is awaited, so that they keep their distance.
        until_scan_ns = self._scan_ns + self._scan_period_ns - now_ns
        if abs(until_scan_ns) > WAIT_SHARE * self._command_ns:
            self._command(now_ns, 0)

    def _command(self, now_ns: int, scan_ns: int) -> None:
        """Publish the velocity for this moment, if there is one."""
        twist = self._navigator.command(now_ns)
        self._publish_changes()
        if twist is None:
            return
        # Base drops a command that is not newer than the last one.
        stamp_ns = max(now_ns, self._commanded_ns + 1)
        self._commanded_ns = stamp_ns
        command = VelocityCommand(
            stamp_ns=stamp_ns, twist=twist, valid_for=VALID_S, scan_ns=scan_ns
        )
        self.publish(topics.COMMAND, command, OWN_SOURCE)

    # The other robots of the house.

    def _watch_others(self) -> None:
        """Hear who they are, where they are and where they drive."""
        others = self._navigator.others
        others.own_name = self.robot

        def hear_pose(pose: PoseEstimate, name: str) -> None:
            others.hear_pose(pose, name, self.arrived_ns)

        def hear_goal(goal: GoalStatus, name: str) -> None:
            others.hear_goal(goal, name, self.arrived_ns)

        def hear_trajectory(trajectory: Path, name: str) -> None:
            others.hear_trajectory(trajectory, name, self.arrived_ns)

        self.watch(topics.ROBOT, robot="*", then=others.hear_robot)
        self.watch(topics.POSE, robot="*", then=hear_pose)
        self.watch(topics.GOAL, robot="*", then=hear_goal)
        self.watch(topics.PATH, robot="*", then=others.hear_path)
        self.watch(topics.TRAJECTORY, robot="*", then=hear_trajectory)

    # What is asked.

    @answers(requests.GOAL_SEND)
    def send_goal(self, params: SendGoal) -> GoalStatus | Later[GoalStatus]:
        """Take a goal."""

        def send() -> GoalStatus:
            status = self._navigator.send(params, self.new_id(), self.now_ns)
            self.log.info("Goal", id=status.id, x=_x(status.pose), y=_y(status.pose))
            self._publish_changes()
            return status

        return self._unless_stopped(send)

    @answers(requests.GOAL_PREVIEW)
    def preview_goal(self, params: SendGoal) -> Path | Later[Path]:
        """Show the way without driving it."""
        return self._unless_stopped(lambda: self._navigator.preview(params, self.now_ns))

    @answers(requests.GOAL_CANCEL)
    def cancel_goal(self, params: WhichGoal) -> GoalStatus:
        """End the current goal."""
        status = self._navigator.cancel(params, self.stamp_ns)
        self._publish_changes()
        return status

    @answers(requests.GOAL_PAUSE)
    def pause_goal(self, params: WhichGoal) -> GoalStatus:
        """Stop and keep the goal."""
        status = self._navigator.pause(params, self.stamp_ns)
        self._publish_changes()
        return status

    @answers(requests.GOAL_RESUME)
    def resume_goal(self, params: WhichGoal) -> GoalStatus | Later[GoalStatus]:
        """Drive on."""

        def resume() -> GoalStatus:
            status = self._navigator.resume(params, self.now_ns)
            self._publish_changes()
            return status

        return self._unless_stopped(resume)

    def _unless_stopped(self, act: Callable[[], R]) -> R | Later[R]:
        """Do what a stop forbids; one that is known of may be over, so base is asked first.

        What base publishes may arrive after a request that came later: requests go first.
        """
        base = self._navigator.senses.base
        if base is None or base.mode != "stopped":
            return act()
        later: Later[R] = self.later()

        def decide(found: dict[tuple[str, ...], BaseState]) -> None:
            if () in found:
                self.take_base(found[()])
            try:
                later.reply(act())
            except Refused as refused:
                later.refuse(refused)

        self.get(topics.BASE, then=decide)
        return later

    @gets(topics.GOAL)
    def get_goal(self, parameters: dict[str, str]) -> dict[tuple[str, ...], GoalStatus]:
        """Return the current goal, or the one of the last 32 that is asked for."""
        goal_id = parameters.get("id")
        if goal_id is None:
            return {(): self._navigator.status(self.stamp_ns)}
        status = self._navigator.status_of(goal_id, self.stamp_ns)
        return {} if status is None else {(): status}

    # What is told.

    @every(STATUS_S)
    def tell_status(self) -> None:
        """Publish how the goal goes, and the path where it changed."""
        now_ns = self.stamp_ns
        if not self._navigator.board.is_active:
            return
        self._publish_changes()
        self.publish(topics.GOAL, self._navigator.status(now_ns))

    @every(COSTMAP_S)
    def tell_costmap(self) -> None:
        """Publish the costmap, rarely while nothing is driven."""
        now_ns = self.stamp_ns
        is_driving = self._navigator.board.is_active
        pause_s = 0.9 * (COSTMAP_S if is_driving else IDLE_COSTMAP_S)
        if now_ns - self._costmap_ns < pause_s * 1e9:
            return
        self._costmap_ns = now_ns
        whole, part = self._navigator.costmaps(now_ns)
        if whole is not None:
            self.publish(topics.COSTMAP_GLOBAL, whole)
        if part is not None:
            self.publish(topics.COSTMAP, part)

    def _publish_changes(self) -> None:
        """Publish each change of the goal in its order, then path and trajectory."""
        for status in self._navigator.board.take_changes():
            self.log.info("Goal", id=status.id, state=status.state, why=status.message or "-")
            self.publish(topics.GOAL, status)
        self._publish_path()
        now_ns = self.stamp_ns
        if now_ns - self._trajectory_ns >= TRAJECTORY_S * 1e9:
            trajectory = self._navigator.trajectory
            if trajectory is not None:
                self._trajectory_ns = now_ns
                self.publish(topics.TRAJECTORY, trajectory)

    def _publish_path(self) -> None:
        """Publish the path where it changed; an empty one when the goal is over."""
        key = self._navigator.path_key
        if key == self._path_key:
            return
        self._path_key = key
        self.publish(topics.PATH, self._navigator.path(self.stamp_ns))


def _x(pose: Pose2D | None) -> float | None:
    return None if pose is None else round(pose.x, 3)


def _y(pose: Pose2D | None) -> float | None:
    return None if pose is None else round(pose.y, 3)
