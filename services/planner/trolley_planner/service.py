"""The planner as a service: goals and sensor data in; velocities, path and costmap out."""

from collections.abc import Callable
from typing import TypeVar

from trolley import requests, topics
from trolley.config import PlannerConfig, RobotConfig
from trolley.extra_sensors import ExtraSensors
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
from trolley.messages.request_params import FollowPerson, SendGoal, WhichGoal
from trolley.runtime.live_config import LiveConfig
from trolley.runtime.service import Later, Service, answers, every, gets, on
from trolley_planner.navigator import Navigator
from trolley_planner.sensing.inputs import OWN_SOURCE, odometry_at
from trolley_planner.waiting_requests import WaitingRequests
from trolley_planner.warmup import warm_up

R = TypeVar("R")
VALID_S = 0.15
"""Time for which a command is valid [s]: short enough that a robot whose planner dies stands within
half a second, braking from full speed included. Below 10 commands a second it is longer."""
VALID_PERIODS = 1.5
"""Least time for which a command is valid, in control periods: the next one comes before."""
STATUS_S = 0.2
"""Period of the goal's status [s]."""
COSTMAP_S = 0.5
"""Period of the costmap while a goal is active [s]."""
IDLE_COSTMAP_S = 2.0
"""Period of the costmap without a goal [s]."""
TRAJECTORY_S = 0.1
"""Least time between two trajectories [s]."""
ODOMETRY_S = 2.0
"""Time for which odometry is kept to place scans [s]."""
MAX_SCAN_PERIOD_NS = 200_000_000
"""Longest time after a scan at which the next one is expected [ns]."""
WAIT_SHARE = 0.4
"""Share of the control period before the next scan within which odometry gives no command."""


def command_period_ns(config: PlannerConfig) -> int:
    """Return the least time between two commands [ns].

    Odometry has a rhythm of its own: a little early is better than a whole period late.
    """
    return round(0.8e9 / config.control_rate_hz)


def command_valid_s(config: PlannerConfig) -> float:
    """Return the time for which a command is valid [s]."""
    return max(VALID_S, VALID_PERIODS / config.control_rate_hz)


class PlannerService(Service):
    """Owns the costmap, the path, the trajectory and the current goal."""

    name = "planner"

    def __init__(self, config: RobotConfig) -> None:
        self._config = config.planner
        self.navigator = Navigator(config.planner)
        self.navigator.inputs.extra_sensors = ExtraSensors(config.base.scans, "mark")
        self._command_ns = command_period_ns(config.planner)
        self._valid_s = command_valid_s(config.planner)
        self.parts = (LiveConfig(self, config, self._use),)
        self._map: OccupancyGrid | None = None
        self._commanded_ns = 0
        self._scan_ns = 0
        self._scan_period_ns = 0
        self._trajectory_ns = 0
        self._costmap_ns = 0
        self._path_key = ""
        self._waiting = WaitingRequests()

    def _use(self, config: RobotConfig) -> None:
        """Apply changed settings."""
        self._command_ns = command_period_ns(config.planner)
        self._valid_s = command_valid_s(config.planner)
        self.navigator.set_config(config.planner)
        self.log.info("Settings changed")

    def prepare(self) -> None:
        """Compile the kernels."""
        warm_up()

    def start(self) -> None:
        """Watch the odometry and the other robots, and report that there is no goal."""
        self._odometry = self.watch(topics.ODOM, seconds=ODOMETRY_S, then=self._on_odometry)
        if self._config.frame == "map":
            self._watch_others()
        self.publish(topics.GOAL, self.navigator.current.status(self.stamp_ns))

    def epoch_began(self) -> None:
        """Stop, since the base was restarted."""
        self._commanded_ns = self._trajectory_ns = self._costmap_ns = 0
        self.navigator.begin_epoch(self.stamp_ns)
        self._publish_changes()

    # Sensor data and state of the robot.

    @on(topics.ROBOT)
    def on_robot(self, robot: Robot) -> None:
        """Keep footprint and limits."""
        self.navigator.inputs.robot = robot

    @on(topics.MAP)
    def on_map(self, grid: OccupancyGrid) -> None:
        """Keep the map."""
        self._map = self.navigator.inputs.map = grid

    @on(topics.ZONES)
    def on_zones(self, zones: Zones) -> None:
        """Keep the zones."""
        self.navigator.inputs.zones = zones

    @on(topics.SUSPECTS)
    def on_suspects(self, suspects: Suspects) -> None:
        """Keep where mirrors are suspected."""
        self.navigator.inputs.suspects = suspects

    @on(topics.COSTS)
    def on_costs(self, grid: OccupancyGrid, source: str) -> None:
        """Keep where a program would rather not have the robot drive."""
        trouble = self.navigator.inputs.costs.update(source, grid, self.stamp_ns)
        if trouble:
            self.count(f"costs/{trouble}")

    @on(topics.POSES)
    def on_poses(self, places: SavedPoses) -> None:
        """Keep the saved poses that goals may name."""
        self.navigator.inputs.places = places

    @on(topics.TF, "laser")
    def on_laser_transform(self, transform: Transform, *_: str) -> None:
        """Keep where the lidar is mounted."""
        self.navigator.inputs.base_T_laser = transform.pose

    @on(topics.TF, "odom", wakes=False)
    def on_odom_transform(self, transform: Transform, *_: str) -> None:
        """Keep the newest correction of the odometry."""
        self.navigator.inputs.update_correction(transform)

    @on(topics.POSE, wakes=False)
    def on_pose(self, pose: PoseEstimate) -> None:
        """Keep the newest pose estimate; as long as it has no map, there is none."""
        inputs = self.navigator.inputs
        inputs.pose, inputs.map = pose, None if pose.map is None else self._map

    @on(topics.BASE)
    def on_base(self, base: BaseState) -> None:
        """Keep the base's state: a stop or another driver pauses the goal."""
        self.navigator.update_base(base, self.stamp_ns)
        self._publish_changes()

    @on(topics.SCAN)
    def on_scan(self, scan: Scan) -> None:
        """Run the cycle: costmap, command, upkeep; scans faster than commands are skipped."""
        now_ns = self.now_ns
        if now_ns is None or 0 <= now_ns - self._scan_ns < self._command_ns:
            return
        self._scan_period_ns = min(now_ns - self._scan_ns, MAX_SCAN_PERIOD_NS)
        self._scan_ns = now_ns
        history = list(self._odometry.history)
        if self.navigator.update_scan(scan, history, now_ns, self.monotonic_ns):
            self._command(now_ns, scan.stamp_ns)
        self.navigator.maintain(now_ns)
        self._publish_changes()

    @on(topics.EXTRA_SCAN, wakes=False)
    def on_extra_scan(self, scan: Scan, name: str) -> None:
        """Keep the echoes of an extra sensor; the next scan of the lidar puts them on the map."""
        history = list(self._odometry.history)
        if not history:
            return
        trouble = self.navigator.inputs.extra_sensors.update(
            name, scan, self.stamp_ns, lambda stamp_ns: odometry_at(history, stamp_ns)
        )
        if trouble:
            self.count(f"scan/{trouble}")

    def _on_odometry(self, odometry: Odometry) -> None:
        self.navigator.inputs.odometry = odometry
        now_ns = self.now_ns
        if now_ns is None or now_ns - self._commanded_ns < self._command_ns:
            return
        # Just before a scan is due, its command is waited for, so that commands stay evenly spaced.
        until_scan_ns = self._scan_ns + self._scan_period_ns - now_ns
        if abs(until_scan_ns) > WAIT_SHARE * self._command_ns:
            self._command(now_ns, 0)

    def _command(self, now_ns: int, scan_ns: int) -> None:
        """Publish the velocity for this moment, if there is one."""
        twist = self.navigator.command(now_ns)
        self._publish_changes()
        if twist is None:
            return
        # Base drops a command that is not newer than the last one.
        stamp_ns = max(now_ns, self._commanded_ns + 1)
        self._commanded_ns = stamp_ns
        command = VelocityCommand(
            stamp_ns=stamp_ns, twist=twist, valid_for=self._valid_s, scan_ns=scan_ns
        )
        self.publish(topics.COMMAND, command, OWN_SOURCE)

    # The other robots of the house.

    def _watch_others(self) -> None:
        """Watch who they are, where they are and where they drive."""
        neighbours = self.navigator.neighbours
        neighbours.own_name = self.robot

        def update_pose(pose: PoseEstimate, name: str) -> None:
            neighbours.update_pose(pose, name, self.arrived_ns)

        def update_goal(goal: GoalStatus, name: str) -> None:
            neighbours.update_goal(goal, name, self.arrived_ns)

        def update_trajectory(trajectory: Path, name: str) -> None:
            neighbours.update_trajectory(trajectory, name, self.arrived_ns)

        self.watch(topics.ROBOT, robot="*", then=neighbours.update_robot)
        # Each is kept for the next scan.
        self.watch(topics.POSE, robot="*", then=update_pose).wakes = False
        self.watch(topics.GOAL, robot="*", then=update_goal).wakes = False
        self.watch(topics.PATH, robot="*", then=neighbours.update_path).wakes = False
        self.watch(topics.TRAJECTORY, robot="*", then=update_trajectory).wakes = False

    # Requests.

    @answers(requests.GOAL_SEND)
    def send_goal(self, params: SendGoal) -> GoalStatus | Later[GoalStatus]:
        """Drive to a goal."""

        def send() -> GoalStatus:
            status = self.navigator.requests.send(params, self.new_id(), self.now_ns)
            self.log.info("Goal", id=status.id, x=_x(status.pose), y=_y(status.pose))
            self._publish_changes()
            return status

        return self._unless_stopped(send)

    @answers(requests.GOAL_FOLLOW)
    def follow_person(self, params: FollowPerson) -> GoalStatus | Later[GoalStatus]:
        """Follow a person."""

        def follow() -> GoalStatus:
            status = self.navigator.requests.follow(params, self.new_id(), self.now_ns)
            self.log.info("Follow", id=status.id, person=status.person)
            self._publish_changes()
            return status

        return self._unless_stopped(follow)

    @answers(requests.GOAL_PREVIEW)
    def preview_goal(self, params: SendGoal) -> Path | Later[Path]:
        """Return the path to a goal without driving it."""
        return self._unless_stopped(lambda: self.navigator.requests.preview(params, self.now_ns))

    @answers(requests.GOAL_CANCEL)
    def cancel_goal(self, params: WhichGoal) -> GoalStatus | Later[GoalStatus]:
        """End the current goal."""

        def cancel() -> GoalStatus:
            status = self.navigator.requests.cancel(params, self.stamp_ns)
            self._publish_changes()
            return status

        return self._in_turn(cancel)

    @answers(requests.GOAL_PAUSE)
    def pause_goal(self, params: WhichGoal) -> GoalStatus | Later[GoalStatus]:
        """Stop and keep the goal."""

        def pause() -> GoalStatus:
            status = self.navigator.requests.pause(params, self.stamp_ns)
            self._publish_changes()
            return status

        return self._in_turn(pause)

    @answers(requests.GOAL_RESUME)
    def resume_goal(self, params: WhichGoal) -> GoalStatus | Later[GoalStatus]:
        """Drive on."""

        def resume() -> GoalStatus:
            status = self.navigator.requests.resume(params, self.now_ns)
            self._publish_changes()
            return status

        return self._unless_stopped(resume)

    def _unless_stopped(self, act: Callable[[], R]) -> R | Later[R]:
        """Run a request that a stop forbids; the last known stop may be over, so ask base first.

        What base publishes may arrive after a request that came later: requests go first.
        """
        base = self.navigator.inputs.base
        if base is None or not base.is_halted:
            return self._in_turn(act)
        later: Later[R] = self.later()
        ready = self._waiting.add(act, later, is_ready=False)

        def decide(found: dict[tuple[str, ...], BaseState]) -> None:
            if () in found:
                self.on_base(found[()])
            ready()

        self.get(topics.BASE, then=decide)
        return later

    def _in_turn(self, act: Callable[[], R]) -> R | Later[R]:
        """Run a request at once, or after those that came before it and wait for base's word.

        While the robot drives none waits: what stops it must not.
        """
        if not self._waiting or self.navigator.current.is_driving:
            return act()
        later: Later[R] = self.later()
        self._waiting.add(act, later, is_ready=True)
        return later

    @gets(topics.GOAL)
    def get_goal(self, parameters: dict[str, str]) -> dict[tuple[str, ...], GoalStatus]:
        """Return the current goal, or the one of the last 32 that is asked for."""
        goal_id = parameters.get("id")
        if goal_id is None:
            return {(): self.navigator.current.status(self.stamp_ns)}
        status = self.navigator.current.status_of(goal_id, self.stamp_ns)
        return {} if status is None else {(): status}

    # Streams.

    @every(STATUS_S)
    def publish_status(self) -> None:
        """Publish the goal's status, and the path if it changed; notice that all is silent."""
        now_ns = self.stamp_ns
        if not self.navigator.current.board.is_active:
            return
        self.navigator.notice_silence(now_ns)
        self._publish_changes()
        self.publish(topics.GOAL, self.navigator.current.status(now_ns))

    @every(COSTMAP_S)
    def publish_costmaps(self) -> None:
        """Publish the costmaps, less often without a goal."""
        now_ns = self.stamp_ns
        is_driving = self.navigator.current.board.is_active
        pause_s = 0.9 * (COSTMAP_S if is_driving else IDLE_COSTMAP_S)
        if now_ns - self._costmap_ns < pause_s * 1e9:
            return
        self._costmap_ns = now_ns
        whole, part = self.navigator.costmaps(now_ns)
        if whole is not None:
            self.publish(topics.COSTMAP_GLOBAL, whole)
        if part is not None:
            self.publish(topics.COSTMAP, part)

    def _publish_changes(self) -> None:
        """Publish each change of the goal in its order, then path and trajectory."""
        for status in self.navigator.current.board.pop_changes():
            self.log.info("Goal", id=status.id, state=status.state, why=status.message or "-")
            self.publish(topics.GOAL, status)
        self._publish_path()
        now_ns = self.stamp_ns
        if now_ns - self._trajectory_ns >= TRAJECTORY_S * 1e9:
            trajectory = self.navigator.current.trajectory
            if trajectory is not None:
                self._trajectory_ns = now_ns
                self.publish(topics.TRAJECTORY, trajectory)

    def _publish_path(self) -> None:
        """Publish the path if it changed; an empty one when the goal is over."""
        key = self.navigator.current.path_key
        if key == self._path_key:
            return
        self._path_key = key
        self.publish(topics.PATH, self.navigator.current.path(self.stamp_ns))


def _x(pose: Pose2D | None) -> float | None:
    return None if pose is None else round(pose.x, 3)


def _y(pose: Pose2D | None) -> float | None:
    return None if pose is None else round(pose.y, 3)
