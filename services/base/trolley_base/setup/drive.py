"""Drives the course of the measurement: turns on the spot, straight strokes to and fro, circles.

It is a machine without a clock: readings in, a velocity out. It trusts nothing that it has not
measured yet. So it begins with a short, slow turn, goes on only if lidar and wheels saw the same,
and drives ahead only once a whole turn has shown enough free floor all round. Turns show where the
lidar sits, strokes how soon the motors obey, and circles, which lead round the same free floor
without a pause, what the wheels' counts are worth: wheels slip at random, so that takes many
metres. Whatever is wrong ends it, with the reason, and from then on the velocity is zero.
"""

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D
from trolley.messages import Imu
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.setup.guidance import PARAMS as GUIDANCE
from trolley_base.setup.guidance import Circle, Guidance
from trolley_base.setup.judge import Judge
from trolley_base.setup.motion import LidarTrack, Turn, WheelCount, axle_of
from trolley_base.setup.record import (
    Command,
    Record,
    SetupRefused,
    Stand,
    Waypoint,
    refuse_silence,
)
from trolley_base.setup.sight import PARAMS as SIGHT
from trolley_base.setup.sight import Beams, Sector, moving_share
from trolley_base.setup.surroundings import Surroundings

Floats = NDArray[np.float64]
Course = Generator[Twist2D]


@dataclass(frozen=True, slots=True)
class DriveParams:
    """How it drives, and when it gives up; set by hand unless stated otherwise."""

    trial_rad: float = 0.5
    """The first turn [rad]."""
    trial_radps: float = 0.4
    """Its turn rate [rad/s]."""
    turn_rad: float = 2.2
    """Turns after that, 126 degrees each where the lidar sees enough [rad]."""
    shared_rad: float = 1.9
    """Part of the lidar's view that is to be the same before a turn and after it [rad]: a robot
    that obeys late turns farther."""
    turn_radps: float = 1.2
    """Their turn rate where limits allow [rad/s]."""
    circle_radps: float = 1.5
    """Highest turn rate on a circle [rad/s]: on smaller ones the robot drives more slowly."""
    circle_share: float = 0.8
    """Share of the turn rate that limits allow that a circle may need: the rest is to steer."""
    turned_rad: float = 8.8
    """How far it turns each way [rad]; then it has seen all directions."""
    speed_mps: float = 0.5
    """Speed of strokes and circles where limits allow [m/s]."""
    trial_mps: float = 0.12
    """Speed of the first stroke [m/s]."""
    trial_m: float = 0.15
    """Length of the first stroke [m]."""
    half_stroke_m: float = 0.45
    """Strokes reach so far ahead and behind where room allows, and circles are so large [m]."""
    least_half_m: float = 0.25
    """Shorter strokes tell too little [m]."""
    driving_s: float = 175.0
    """How long it drives in all [s]: circles go on until then, since slip averages out."""
    strokes: tuple[float, ...] = (1.0, -1.0, 1.0, -1.0, 1.0, 0.0, -1.0, 0.0, 1.0)
    """Where they end, as a share of how far they reach. Two are broken in the middle: these show
    the way without the play of the wheels, which comes where a wheel turns back."""
    rounds: float = 2.5
    """Number of rounds on the circle before the robot stands, so that it knows where it is."""
    least_round_s: float = 3.0
    """In less time a circle is not begun [s]."""
    circle_steering: float = 0.8
    """Turn rate per error of the heading on a circle [1/s]."""
    circle_trim: float = 0.05
    """Added to the turn rate on a circle per error of the heading and time [1/s^2]."""
    off_circle_m: float = 0.06
    """A robot that is farther outside stands, turns and begins anew [m]; half the margin."""
    farther_m: float = 0.02
    """One that was farther outside already does when it is outside by so much more [m]."""
    steering: float = 1.0
    """Turn rate per error of the heading on a stroke [1/s]."""
    most_steering_radps: float = 0.3
    """Highest turn rate on a stroke [rad/s]."""
    heading_rad: float = 0.06
    """Error of the heading beyond which it is turned back between two strokes [rad]."""
    creep_mps: tuple[float, ...] = (0.005, 0.007, 0.01, 0.014, 0.02, 0.028, 0.04, 0.056, 0.08)
    """Speeds that are tried for the slowest that moves the robot [m/s]."""
    creep_s: float = 0.9
    """How long each of them is tried [s]."""
    settle_s: float = 0.5
    """How long the wheels must have stood before scans are taken [s]."""
    scans: int = 6
    """Number of scans that are taken at a stand."""
    tries: int = 4
    """Number of times that scans are taken where something moves around the robot."""
    moved_m: float = 0.1
    """A robot that is to go round has to get on by so much within the time below [m]."""
    patience_s: float = 3.0
    """Longest time until the robot moves as told [s]."""
    stand_s: float = 12.0
    """Longest time until it has come to rest and is seen [s]."""


PARAMS = DriveParams()


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast it may drive.

    Attributes:
        speed_mps: on strokes and circles [m/s].
        turn_radps: on turns on the spot [rad/s].
        circle_radps: on a circle [rad/s].
        limit_radps: with what is added to steer [rad/s].
    """

    speed_mps: float
    turn_radps: float
    circle_radps: float
    limit_radps: float

    @classmethod
    def within(cls, speed_mps: float, turn_radps: float) -> "Pace":
        """Return that of a robot with these limits."""
        return cls(
            min(PARAMS.speed_mps, speed_mps),
            min(PARAMS.turn_radps, turn_radps),
            min(PARAMS.circle_radps, PARAMS.circle_share * turn_radps),
            turn_radps,
        )

    def on(self, circle: Circle) -> float:
        """Return the speed on a circle [m/s]."""
        return min(self.speed_mps, self.circle_radps * circle.radius_m)


class Clock:
    """Robot time, and how long it has driven."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.begun_ns: int | None = None
        """When the first step was."""
        self._driven_ns = 0

    def advance(self, now_ns: int, *, was_driving: bool) -> None:
        """Go on to a robot time."""
        if self.begun_ns is None:
            self.begun_ns = now_ns
        elif was_driving:
            self._driven_ns += now_ns - self.now_ns
        self.now_ns = now_ns

    @property
    def driven_s(self) -> float:
        """How long something else than zero was commanded [s]."""
        return self._driven_ns * 1e-9

    def deadline(self, seconds: float) -> int:
        """Return the robot time so long from now."""
        return self.now_ns + round(seconds * 1e9)


class SetupDrive:
    """The drive; see the module.

    Args:
        footprint: (n, 2) corners [m] in `base_link`.
        half_track_m: half of the track that the board calculates with [m].
        own: where a person has said that the lidar sees the robot itself.
        speed_mps: it drives no faster than this, and than is set above.
        turn_radps: the same for turns.
        driving_s: how long it drives in all, but for turns and strokes.
    """

    def __init__(
        self,
        footprint: Floats,
        half_track_m: float,
        own: Sequence[Sector] = (),
        *,
        speed_mps: float = math.inf,
        turn_radps: float = math.inf,
        driving_s: float = PARAMS.driving_s,
    ) -> None:
        self.record = Record()
        self.problem: str | None = None
        """Why it was given up."""
        self.has_ended = False
        self.step_name = "looking"
        """What it does, for people."""
        self.slowest_mps: float | None = None
        """The slowest commanded speed that moved the wheels [m/s]."""
        self._surroundings = Surroundings(footprint, own)
        self._pace = Pace.within(speed_mps, turn_radps)
        self._lidar, self._wheels = LidarTrack(), WheelCount()
        self._guidance = Guidance(self._lidar)
        self._judge = Judge(
            half_track_m, self._lidar, self._wheels, self._guidance.mount, self.record
        )
        self._clock = Clock()
        self._course = self._drive(driving_s)

    def step(
        self,
        now_ns: int,
        motions: Sequence[MotionSample],
        scans: Sequence[LidarScan],
        imu: Sequence[Imu] = (),
    ) -> Twist2D:
        """Take what the devices said, and return the velocity until the next step.

        Args:
            now_ns: robot time.
            motions: new ones, oldest first.
            scans: the same.
            imu: the same.
        """
        self._clock.advance(now_ns, was_driving=not self.record.command.is_zero)
        if self.has_ended:
            return Twist2D.zero()
        try:
            self._take(motions, scans, imu)
            self._watch()
            command = next(self._course)
        except StopIteration:
            self.has_ended, command = True, Twist2D.zero()
        except SetupRefused as refusal:
            self.give_up(str(refusal))
            command = Twist2D.zero()
        if command != self.record.command:
            self.record.commands.append(Command(now_ns, command))
        return command

    @property
    def own(self) -> list[Sector]:
        """Where the lidar sees the robot itself; once it has turned round, measured."""
        return self._surroundings.own

    @property
    def echoes(self) -> Floats:
        """What the lidar has seen at the last stand (n, 2), in frame `laser` [m]."""
        beams = self._beams
        return beams.points(self.record.stands[-1].ranges, beams.outside([]))

    def give_up(self, problem: str) -> None:
        """End it, with the reason."""
        self.has_ended = True
        self.problem = self.problem or problem

    # The course.
    def _drive(self, driving_s: float) -> Course:
        yield from self._stand()
        self._surroundings.refuse_near(self._beams, self.record.stands[0].ranges)
        self.step_name = "a first short turn"
        yield from self._turn(PARAMS.trial_rad, PARAMS.trial_radps)
        yield from self._stand()
        self._judge.learn_sense()
        self._judge_stretch()
        line = self._guidance.line
        view_rad = self._lidar.view_rad(self.own)
        turn_rad = min(PARAMS.turn_rad, max(PARAMS.trial_rad, view_rad - PARAMS.shared_rad))
        num_turns = math.ceil(PARAMS.turned_rad / turn_rad)
        for number in range(2 * num_turns):
            self.step_name = f"turn {number + 1} of {2 * num_turns}"
            way = 1.0 if number < num_turns else -1.0
            yield from self._turn(way * turn_rad, self._pace.turn_radps)
            yield from self._stand()
            self._judge_stretch()
            beyond = abs(self._judge.moved.yaw) - turn_rad
            line.turn_lead_s = max(0.0, beyond / self._pace.turn_radps)
            if number + 1 == num_turns:
                self._learn_own()
        half_m = self._find_room()
        yield from self._first_stroke()
        yield from self._creep()
        for number, share in enumerate(PARAMS.strokes):
            self.step_name = f"stroke {number + 1} of {len(PARAMS.strokes)}"
            yield from self._stroke(share * half_m)
        line.linear, line.angular = self._roughly_worth()
        middle_s = 0.5 * (self._clock.driven_s + driving_s)
        for side, until_s in ((1.0, middle_s), (-1.0, driving_s)):
            while self._clock.driven_s < until_s - PARAMS.least_round_s:
                yield from self._go_round(Circle(half_m, side), until_s, driving_s)
                yield from self._stand()

    def _first_stroke(self) -> Course:
        """Drive a little ahead: the way that the lidar goes is ahead."""
        self.step_name = "a first short stroke"
        before = self._lidar.pose
        self._guidance.line.heading_rad = self._lidar.here.yaw
        self._guidance.line.start_T_first = self.record.stands[-1].start_T_laser
        trial_m, mps = PARAMS.trial_m, PARAMS.trial_mps
        until_ns = self._clock.deadline(trial_m / mps + PARAMS.patience_s)
        while before.distance_to(self._lidar.pose) + self._age_s * mps < trial_m:
            self._refuse_late(until_ns, "The robot does not drive ahead as told")
            yield Twist2D(mps, 0.0, 0.0)
        yield from self._stand()
        self._judge_stretch()
        first, last = self.record.stands[-2].start_T_laser, self.record.stands[-1].start_T_laser
        moved = first.inverse() @ last
        # Half of the turn on the way, since the robot drove an arc.
        direction = math.atan2(moved.y, moved.x) - 0.5 * moved.yaw
        if self._wheels.between_stands()[0] < 0.0:
            direction += math.pi
        self._guidance.mount.ahead = np.array([math.cos(direction), math.sin(direction)])
        beyond_m = math.hypot(moved.x, moved.y) - trial_m
        faster = max(0.0, self._pace.speed_mps - mps)
        self._guidance.line.lead_s = max(GUIDANCE.lead_s, beyond_m / mps)
        self._guidance.line.lead_s += faster / (2.0 * GUIDANCE.motors_mps2)

    def _creep(self) -> Course:
        """Find the slowest speed at which the wheels turn."""
        self.step_name = "how slowly it can drive"
        for speed in PARAMS.creep_mps:
            until_ns = self._clock.deadline(PARAMS.creep_s)
            middle_ns = self._clock.deadline(0.5 * PARAMS.creep_s)
            way = None
            while self._clock.now_ns < until_ns:
                if way is None and self._clock.now_ns >= middle_ns:
                    way = self._wheels.way
                yield Twist2D(speed, 0.0, 0.0)
            expected = 0.5 * PARAMS.creep_s * speed
            if way is not None and self._wheels.way - way > 0.5 * expected:
                self.slowest_mps = speed
                break
        yield from self._stand()

    # Its parts.
    def _turn(self, angle: float, rate: float) -> Course:
        """Turn on the spot until the lidar has seen it."""
        turn = Turn(self._lidar.pose.yaw)
        until_ns = self._clock.deadline(abs(angle) / rate * 1.8 + PARAMS.patience_s)
        while abs(turn.update(self._lidar.pose.yaw)) < abs(angle):
            self._refuse_late(until_ns, "The robot does not turn as told")
            yield Twist2D(0.0, 0.0, math.copysign(rate, angle))

    def _stroke(self, target_m: float) -> Course:
        """Drive straight until the robot is so far ahead of where the strokes began, and stand."""
        yield from self._turn_to(lambda: self._guidance.heading_error(target_m))
        way, length_m = self._guidance.way_to(target_m), abs(target_m - self._guidance.place[0])
        yield from self._go_to(target_m, self._pace.speed_mps)
        yield from self._stand()
        self._judge_stretch()
        beyond_m = way * (self._guidance.place[0] - target_m)
        self._guidance.line.learn_lead(beyond_m, self._pace.speed_mps, length_m)

    def _turn_to(self, error_of: Callable[[], float]) -> Course:
        """Turn to a heading, if another is far off.

        Args:
            error_of: how far the robot is turned to the left of it now [rad].
        """
        error = error_of()
        rate = PARAMS.trial_radps if abs(error) < PARAMS.trial_rad else self._pace.turn_radps
        lead = max(0.02, self._guidance.line.turn_lead_s * rate)
        if abs(error) > max(PARAMS.heading_rad, lead):
            until_ns = self._clock.deadline(abs(error) / rate + PARAMS.patience_s)
            turn, way = Turn(error), math.copysign(1.0, error)
            while way * (error + turn.update(error_of())) > lead:
                self._refuse_late(until_ns, "The robot does not turn as told")
                yield Twist2D(0.0, 0.0, -way * rate)
            yield from self._stand()

    def _go_to(self, target_m: float, speed: float) -> Course:
        """Drive along the line until the robot is so far ahead of where the strokes began."""
        way, begun_ns = self._guidance.way_to(target_m), self._clock.now_ns
        seconds = abs(target_m - self._guidance.place[0]) / speed
        until_ns = self._clock.deadline(1.8 * seconds + PARAMS.patience_s)
        line = self._guidance.line
        while way * (target_m - self._guidance.place[0]) > (line.lead_s + self._age_s) * speed:
            self._refuse_late(until_ns, "The robot does not drive as told")
            turn = -line.bend * way * speed
            if self._clock.now_ns - begun_ns > 700_000_000:  # the start shows how the motors follow
                limit = PARAMS.most_steering_radps
                steering = PARAMS.steering * self._guidance.heading_error(target_m)
                turn -= max(-limit, min(limit, steering))
            yield Twist2D(way * speed, 0.0, turn)

    def _go_round(self, circle: Circle, until_s: float, driving_s: float) -> Course:
        """Drive rounds on a circle, until it is time to stand or the robot is too far outside.

        Args:
            circle: it.
            until_s: when it is to be over at the latest, as time of driving [s].
            driving_s: when the whole drive is [s].
        """
        yield from self._turn_to(lambda: self._guidance.circle_error(circle)[0])
        speed = self._pace.on(circle)
        limit, most_radps = PARAMS.most_steering_radps, self._pace.limit_radps
        trim, last_ns = 0.0, self._clock.now_ns
        most_m = max(PARAMS.off_circle_m, self._guidance.circle_error(circle)[1] + PARAMS.farther_m)
        was_at, moved_by_ns = self._guidance.place, self._clock.deadline(PARAMS.patience_s)
        until_ns = self._clock.deadline(PARAMS.rounds * 2.0 * math.pi * circle.radius_m / speed)
        while self._clock.now_ns < until_ns and self._clock.driven_s < until_s:
            self.step_name = f"circles, {driving_s - self._clock.driven_s:.0f} s left"
            self._refuse_late(moved_by_ns, "The robot does not drive in a circle as told")
            if math.dist(was_at, self._guidance.place) > PARAMS.moved_m:
                was_at, moved_by_ns = self._guidance.place, self._clock.deadline(PARAMS.patience_s)
            error, outside_m = self._guidance.circle_error(circle)
            if outside_m > most_m:
                return
            trim -= PARAMS.circle_trim * error * (self._clock.now_ns - last_ns) * 1e-9
            trim, last_ns = max(-limit, min(limit, trim)), self._clock.now_ns
            steering = max(-limit, min(limit, trim - PARAMS.circle_steering * error))
            turn = self._guidance.line.turn_for(speed, circle, steering)
            yield Twist2D(speed, 0.0, max(-most_radps, min(most_radps, turn)))

    def _stand(self) -> Course:
        """Come to rest, and note where."""
        until_ns = self._clock.deadline(PARAMS.stand_s)
        for _ in range(PARAMS.tries):
            scans = yield from self._rest(until_ns)
            if moving_share(self._beams, scans) <= SIGHT.moving_share:
                self._note_stand(scans)
                return
        raise SetupRefused(
            "Something moves around the robot, or somebody moves the robot: what the lidar sees "
            "changes while the wheels stand. Keep away from it, and start again."
        )

    def _rest(self, until_ns: int) -> Generator[Twist2D, None, list[LidarScan]]:
        self._lidar.scans.clear()
        while True:
            since_ns = self._wheels.still_since_ns
            if since_ns is not None:
                from_ns = since_ns + round(PARAMS.settle_s * 1e9)
                scans = [scan for scan in self._lidar.scans if _first_ns(scan) > from_ns]
                if len(scans) >= PARAMS.scans:
                    return scans
            self._refuse_late(until_ns, "The robot does not come to rest")
            yield Twist2D.zero()

    def _note_stand(self, scans: list[LidarScan]) -> None:
        stands = self.record.stands
        turned_rad = self._lidar.since_stand.yaw
        start_T_laser, ranges, is_plain = self._lidar.note_stand(scans, self.own, len(stands))
        self._judge.refuse_plain(turned_rad, is_plain=is_plain)
        since_ns = self._wheels.still_since_ns
        assert since_ns is not None
        self._wheels.note_stand()
        stands.append(Stand(since_ns, _last_ns(scans[-1]), start_T_laser, ranges, is_plain))

    # What it learns.
    def _learn_own(self) -> None:
        """Learn where the axle is, and what has turned with the robot."""
        stands = self.record.stands
        telling = [one.start_T_laser for one in stands if not one.is_plain]
        self._guidance.mount.axle = axle_of(telling)
        self._surroundings.learn_own(self._beams, stands)

    def _find_room(self) -> float:
        """Return how far strokes may reach; refuse where there is too little room."""
        axle = self._guidance.mount.axle
        assert axle is not None  # it has turned
        half_m = PARAMS.least_half_m, PARAMS.half_stroke_m
        return self._surroundings.find_room(self._beams, self.record.stands, axle, half_m)

    def _judge_stretch(self) -> None:
        """Refuse what wheels and lidar saw quite differently, and learn how straight it goes."""
        self._judge.refuse_odd()
        way, turn = self._wheels.between_stands()
        turned = self._guidance.mount.sign * self._judge.moved.yaw
        self._guidance.line.learn_bend(way, turn, turned)

    def _refuse_late(self, until_ns: int, what: str) -> None:
        if self._clock.now_ns > until_ns:
            raise SetupRefused(f"{what}: {self._judge.why_not(self._clock.now_ns)}")

    # What is always watched.
    def _take(
        self, motions: Sequence[MotionSample], scans: Sequence[LidarScan], imu: Sequence[Imu]
    ) -> None:
        for motion in motions:
            self.record.motions.append(motion)
            self._wheels.take(motion, is_to_stand=self.record.command.is_zero)
        self.record.imu.extend(imu)
        for scan in scans:
            if self._lidar.take(scan):
                self._follow(scan)
                self.record.waypoints.append(Waypoint(scan.stamp_ns, self._lidar.pose))

    def _follow(self, scan: LidarScan) -> None:
        twist = self._lidar.follow(scan, self.own)
        self._judge.refuse_too_fast(twist, self._clock.now_ns, self._pace.speed_mps)
        self._judge.refuse_unseen()
        command = self.record.command
        if not command.is_zero:
            beams = Beams.of(scan)
            points = beams.points(scan.ranges, beams.outside(self.own))
            stopping_m = (self._guidance.line.lead_s + self._age_s) * abs(command.vx)
            mount = self._guidance.mount
            self._surroundings.body.refuse_obstacle(points, mount, command, stopping_m)

    def _watch(self) -> None:
        """Refuse to go on without the devices."""
        begun_ns, now_ns, motions = self._clock.begun_ns, self._clock.now_ns, self.record.motions
        assert begun_ns is not None
        heard_ns = max(begun_ns, motions[-1].stamp_ns if motions else 0)
        refuse_silence("motor board", heard_ns, now_ns)
        refuse_silence("lidar", max(begun_ns, self._lidar.latest_ns), now_ns)

    # Figures.
    @property
    def _age_s(self) -> float:
        """How long ago the newest scan was taken [s]: the robot is farther by now."""
        return (self._clock.now_ns - self._lidar.latest_ns) * 1e-9

    @property
    def _beams(self) -> Beams:
        beams = self._lidar.beams
        assert beams is not None  # it has stood, so there are scans
        return beams

    def _roughly_worth(self) -> tuple[float, float]:
        """Return about how many metres a metre counted is really, and radians a radian."""
        ways, turns = np.zeros(2), np.zeros(2)
        for index, (before, after) in enumerate(pairwise(self.record.stands)):
            way, turn = self._wheels.between_stands(index)
            seen = before.start_T_laser.inverse() @ after.start_T_laser
            if abs(turn) > PARAMS.trial_rad:
                turns += abs(turn), abs(seen.yaw)
            elif abs(way) > PARAMS.least_half_m:
                ways += abs(way), math.hypot(seen.x, seen.y)
        return float(ways[1] / ways[0]), float(turns[1] / turns[0])


def _duration_ns(scan: LidarScan) -> int:
    return round(max(len(scan.ranges) - 1, 0) * scan.time_increment * 1e9)


def _first_ns(scan: LidarScan) -> int:
    """Return when the first of its beams was measured."""
    return scan.stamp_ns + min(0, _duration_ns(scan))


def _last_ns(scan: LidarScan) -> int:
    """Return when the last of its beams was measured."""
    return scan.stamp_ns + max(0, _duration_ns(scan))
