"""What the devices report: read, joined to the odometry, logged and published."""

import numpy as np

from trolley import codes, topics
from trolley.config import RobotConfig
from trolley.extra_sensors import ExtraSensors
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley.messages import Battery, Link, Odometry, Scan, Transform, floats_to_bytes
from trolley.messages.motion import CHASSIS
from trolley.runtime.service import Service, gets, on
from trolley_base.board_sensors import BoardSensors
from trolley_base.device_log import DeviceLog
from trolley_base.drivers import ChassisReading, Hardware, LidarReading, LidarScan
from trolley_base.odometry.dead_reckoning import DeadReckoning, Measured
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.robot_clock import Beat
from trolley_base.safety.lidar_sight import LidarSight
from trolley_base.safety.safety_state import SafetyState

ODOMETRY_S = 0.04
"""Every other reading is published, and one with each scan: 25 to 35 Hz."""


class DeviceInputs:
    """The newest readings of chassis and lidar, and the track that they make up.

    Args:
        sight: what the lidar sees.
        base_T_laser: where it sits.
        extra_sensors: sensors beside the lidar that may stop the robot.
        board_sensors: those of the motor board.
    """

    def __init__(
        self,
        service: Service,
        sight: LidarSight,
        base_T_laser: Pose2D,
        extra_sensors: ExtraSensors,
        board_sensors: BoardSensors,
    ) -> None:
        self._service = service
        self._extra_sensors = extra_sensors
        self._board_sensors = board_sensors
        self._base_T_laser = base_T_laser
        self.sight = sight
        """What the lidar sees."""
        self._chassis = ChassisReading((), Link(name=CHASSIS, state="searching"))
        self._lidar = LidarReading((), Link(name="lidar", state="searching"))
        self._has_moved = True
        self._odometry_beat = Beat(ODOMETRY_S)
        self.battery: Battery | None = None
        """The newest charge, None while the board has not measured it."""
        self.echoes, self.unseen = sight.around(Pose2D.identity())
        """(n, 2) what the lidar, and extra sensors, saw near the robot [m], and what the lidar has
        not seen there, both in `base_link`."""
        self.silent_sensors: list[str] = []
        """Names of extra sensors that have gone silent."""

    def begin(
        self, hardware: Hardware, config: RobotConfig, scales: WheelScales, epoch_ns: int
    ) -> None:
        """Begin a run with devices that have been opened."""
        self._hardware = hardware
        self._extra_sensors.forget()
        self._reckoning = DeadReckoning(config, scales, epoch_ns, self._base_T_laser)
        self.sight.begin(knows_motion=self._reckoning.has_wheels)
        self._device_log = DeviceLog(self._service.log, self._service.count)

    @property
    def links(self) -> list[Link]:
        """The connections to the chassis and the lidar."""
        return [self._chassis.link, self._lidar.link]

    @property
    def has_ended(self) -> bool:
        """Whether a recording has been played to its end."""
        return self._hardware.has_ended

    @property
    def measured(self) -> Measured:
        """What wheels and gyro measured of the robot's own motion by the newest reading."""
        return self._reckoning.measured

    @property
    def trouble(self) -> str:
        """What is wrong with the odometry, as a sentence; "" while nothing is known to be."""
        return self._reckoning.trouble

    @property
    def is_button_pressed(self) -> bool:
        """Whether the board reports its stop button."""
        return codes.BUTTON in self._chassis.alarms

    def safety_state(
        self, now_ns: int, cannot_drive: str, *, is_stopped: bool, own_pause_ns: int
    ) -> SafetyState:
        """Return what the devices say about whether the robot may drive."""
        lidar, age_ns = self.sight.judged(self._lidar.link), self.sight.age_ns(now_ns)
        return SafetyState(
            cannot_drive,
            is_stopped,
            own_pause_ns,
            self._chassis,
            lidar,
            age_ns,
            self._lidar.is_gone,
        )

    def update(self, now_ns: int) -> None:
        """Bring the devices up to now, and read them."""
        self._hardware.advance(now_ns)
        self._read_chassis(now_ns)
        self._read_lidar(now_ns)
        odom_T_base = self._reckoning.track.odom_T_base
        self.echoes, self.unseen = self.sight.around(odom_T_base)
        further = self._extra_sensors.points_odom(now_ns)
        if len(further):
            further = odom_T_base.inverse().transform_points(further)
            self.echoes = np.concatenate([self.echoes, further])
        self.silent_sensors = self._extra_sensors.silent(now_ns)

    def command(self, now_ns: int, twist: Twist2D) -> None:
        """Take what is driven from now on."""
        self._reckoning.command(now_ns, twist)

    def _read_chassis(self, now_ns: int) -> None:
        reading = self._chassis = self._reckoning.add_reading(self._hardware.chassis.read())
        self._has_moved = self._has_moved or bool(reading.motions)
        for imu in reading.imu:
            self._service.publish_if_heard(topics.IMU, lambda imu=imu: imu)
        for scan in self._board_sensors.scans(reading, now_ns):
            self._service.publish(topics.EXTRA_SCAN, scan, scan.frame)
            self._add_sensor(scan, scan.frame)
        self.battery = reading.battery or self.battery
        self._device_log.add(now_ns, reading.link, reading.notes, reading.counts)

    def _read_lidar(self, now_ns: int) -> None:
        reading = self._lidar = self._hardware.lidar.read()
        self._device_log.add(now_ns, reading.link, reading.notes, reading.counts)
        for scan in reading.scans:
            self._reckoning.add_scan(scan)
        self._has_moved = self._reckoning.carry_on(now_ns) or self._has_moved
        # With each scan the odometry up to its last beam, so that nobody has to wait for it.
        if self._has_moved and (self._odometry_beat.is_due(now_ns) or reading.scans):
            self._has_moved = False
            self._publish_odometry()
        for scan in reading.scans:
            self._publish_scan(scan)
            if len(scan.ranges):
                self.sight.update(scan, self._reckoning.track, now_ns)

    def _publish_odometry(self) -> None:
        track = self._reckoning.track
        self._service.publish(
            topics.ODOM,
            Odometry(stamp_ns=track.stamp_ns, pose=track.odom_T_base, twist=track.twist),
        )

    def _publish_scan(self, scan: LidarScan) -> None:
        message = Scan(
            stamp_ns=scan.stamp_ns,
            frame="laser",
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            time_increment=scan.time_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            ranges=floats_to_bytes(scan.ranges),
            intensities=floats_to_bytes(scan.intensities),
        )
        self._service.publish(topics.SCAN, message)

    @on(topics.EXTRA_SCAN)
    def take_extra_scan(self, scan: Scan, name: str) -> None:
        """Take the echoes of an extra sensor; what the board feels did not have to come back."""
        if name not in self._board_sensors.names:
            self._add_sensor(scan, name)

    def _add_sensor(self, scan: Scan, name: str) -> None:
        def odom_T_base(stamp_ns: int) -> Pose2D:
            x, y, yaw = self._reckoning.track.poses_at(np.array([stamp_ns])).tolist()[0]
            return Pose2D(x, y, wrap_angle(yaw))

        trouble = self._extra_sensors.update(name, scan, self._service.stamp_ns, odom_T_base)
        if trouble:
            self._service.count(f"scan/{trouble}")

    @gets(topics.TF, "base_link")
    def odometry_frame(self, _: dict[str, str]) -> dict[tuple[str, ...], Transform]:
        """Answer `get tf/base_link` from the odometry."""
        track = self._reckoning.track
        frame = Transform(
            stamp_ns=track.stamp_ns, parent="odom", child="base_link", pose=track.odom_T_base
        )
        return {("base_link",): frame}
