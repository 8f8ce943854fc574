"""Where the robot is as strokes and circles have it, and how it has to steer on them."""

import math
from dataclasses import dataclass, field

from trolley.geometry import Pose2D, angle_difference
from trolley_base.setup.clearance import Mount
from trolley_base.setup.motion import LidarTrack


@dataclass(frozen=True, slots=True)
class GuidanceParams:
    """How it is led to where it should be; set by hand."""

    return_m: float = 0.5
    """Length over which a stroke leads back to the line, at least [m]."""
    circle_return_m: float = 1.0
    """Distance from the circle by angle at which the robot is led back to it [m]."""
    most_return_rad: float = 0.25
    """Largest angle to the line, or to the circle, at which it does [rad]."""
    lead_s: float = 0.25
    """A stroke is stopped so long before its end until a stop has shown what is right [s]."""
    motors_mps2: float = 1.0
    """Motors are taken to be so weak until a stroke at full speed has shown them [m/s^2]."""
    bend_m: float = 0.5
    """Length of a stroke whose bend counts as much as what was known of it before [m]."""
    least_bend_m: float = 0.075
    """Shorter ways show no bend [m]."""
    most_turn_rad: float = 0.4
    """Ways on which it turns more are turns, not bends [rad]."""


PARAMS = GuidanceParams()


@dataclass(frozen=True, slots=True)
class Circle:
    """Around where strokes began; its middle lies to the left of the robot, 1, or the right, -1."""

    radius_m: float
    side: float


@dataclass(slots=True)
class Line:
    """The line on which strokes go to and fro.

    Attributes:
        start_T_first: where the lidar was when they began, as in `Stand.start_T_laser`.
        heading_rad: its direction then.
        bend: turn per way that the wheels make of a command to go straight [rad/m].
        linear, angular: about what a metre and a radian that wheels count are really.
        lead_s: how long before its end a stroke is stopped: the robot obeys late [s].
        turn_lead_s: the same of turns [s].
    """

    start_T_first: Pose2D = field(default_factory=Pose2D.identity)
    heading_rad: float = 0.0
    bend: float = 0.0
    linear: float = 1.0
    angular: float = 1.0
    lead_s: float = PARAMS.lead_s
    turn_lead_s: float = 0.0

    def turn_for(self, speed: float, circle: Circle, steering: float) -> float:
        """Return the turn rate to command on a circle [rad/s].

        Args:
            speed: that is commanded [m/s].
            circle: where the robot goes round.
            steering: how much faster it should turn to the left, really [rad/s].
        """
        turning = circle.side * speed * self.linear / circle.radius_m
        return (turning + steering) / self.angular - self.bend * speed

    def learn_bend(self, way: float, turn: float, turned: float) -> None:
        """Learn from a way, if it was one, how far the wheels turn the robot on it.

        Args:
            way: that they counted [m].
            turn: that they counted [rad].
            turned: how far it really turned [rad].
        """
        if abs(turn) <= PARAMS.most_turn_rad and abs(way) > PARAMS.least_bend_m:
            share = abs(way) / (abs(way) + PARAMS.bend_m)
            self.bend += share * ((turned - turn) / way - self.bend)

    def learn_lead(self, beyond_m: float, speed: float, length_m: float) -> None:
        """Learn from a stroke, but not from one too short to gather speed.

        Args:
            beyond_m: how far it led beyond its end [m].
            speed: at which it was told to go [m/s].
            length_m: from where it began to its end [m].
        """
        if length_m > self.lead_s * speed + speed**2 / (2.0 * PARAMS.motors_mps2):
            self.lead_s = max(0.0, self.lead_s + 0.5 * beyond_m / speed)


class Guidance:
    """Leads along the line, and round circles.

    Args:
        lidar: shows where it is.
    """

    def __init__(self, lidar: LidarTrack) -> None:
        self.mount = Mount()
        self.line = Line()
        self._lidar = lidar

    @property
    def place(self) -> tuple[float, float]:
        """How far the robot is ahead of where the strokes began, and to the left of it [m]."""
        axle = self.mount.axle
        assert self.mount.ahead is not None
        assert axle is not None
        moved = self.line.start_T_first.inverse() @ self._lidar.here
        x, y = (moved.transform_points(axle[None])[0] - axle).tolist()
        ahead_x, ahead_y = self.mount.ahead.tolist()
        return ahead_x * x + ahead_y * y, self.mount.sign * (ahead_x * y - ahead_y * x)

    def way_to(self, target_m: float) -> float:
        """Return whether a stroke leads ahead, 1, or back, -1."""
        return math.copysign(1.0, target_m - self.place[0])

    def heading_error(self, target_m: float) -> float:
        """How far the robot is turned to the left of where a stroke should lead [rad].

        Off the line it should lead back to it.
        """
        turned = angle_difference(self._lidar.here.yaw, self.line.heading_rad)
        along, aside = self.place
        limit = PARAMS.most_return_rad
        back = aside / max(PARAMS.return_m, abs(target_m - along))
        back = self.way_to(target_m) * max(-limit, min(limit, back))
        return self.mount.sign * turned + back

    def circle_error(self, circle: Circle) -> tuple[float, float]:
        """How far the robot is turned to the left of where a circle leads [rad], and outside [m].

        Off the circle it should lead back to it.
        """
        along, aside = self.place
        outside_m = math.hypot(along, aside) - circle.radius_m
        limit = PARAMS.most_return_rad
        back = max(-limit, min(limit, outside_m / PARAMS.circle_return_m))
        wanted = math.atan2(aside, along) + circle.side * (0.5 * math.pi + back)
        turned = self.mount.sign * angle_difference(self._lidar.here.yaw, self.line.heading_rad)
        return angle_difference(turned, wanted), outside_m
