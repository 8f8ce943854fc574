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
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.messages import Imu
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.setup.clearance import PARAMS as CLEARANCE
from trolley_base.setup.clearance import Body, Mount
from trolley_base.setup.motion import LidarTrack, WheelCount, axle_of
from trolley_base.setup.record import (
    Command,
    Record,
    SetupRefused,
    Stand,
    Waypoint,
    refuse_silence,
)
from trolley_base.setup.sight import PARAMS as SIGHT
from trolley_base.setup.sight import (
    Beams,
    Room,
    Sector,
    is_within,
    moving_share,
    near_sectors,
    own_sectors,
)

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
    """Turns after that, 126 degrees each [rad]."""
    turn_radps: float = 1.2
    """Their turn rate where limits allow [rad/s]."""
    circle_radps: float = 1.5
    """Highest turn rate on a circle [rad/s]: on smaller ones the robot drives more slowly."""
    circle_share: float = 0.8
    """Share of the turn rate that limits allow that a circle may need: the rest is to steer."""
    num_turns: int = 4
    """Number of turns each way; after those of one way it has seen all directions."""
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
    circle_return_m: float = 1.0
    """Distance from the circle by angle at which the robot is led back to it [m]."""
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
    return_m: float = 0.5
    """Length over which a stroke leads back to the line, at least [m]."""
    most_return_rad: float = 0.25
    """Largest angle to the line, or to the circle, at which it does [rad]."""
    lead_s: float = 0.25
    """A stroke is stopped so long before its end until a stop has shown what is right [s]."""
    motors_mps2: float = 1.0
    """Motors are taken to be so weak until a stroke at full speed has shown them [m/s^2]."""
    bend_m: float = 0.5
    """Length of a stroke whose bend counts as much as what was known of it before [m]."""
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
    too_fast: float = 1.8
    """A robot that moves so many times as fast as told is stopped."""
    follows_s: float = 1.5
    """The robot may follow a command for so long after the next one [s]: it is late, and brakes."""
    most_plain: int = 1
    """Number of stands in a row at which it may see one wall only while it turns."""
    num_fast: int = 3
    """Number of scans in a row that must say so."""
    differ: float = 0.3
    """Share by which lidar and wheels may differ before anything is measured."""
    differ_m: float = 0.05
    """Added to that for ways [m]."""
    differ_rad: float = 0.12
    """Added to that for turns [rad]."""
    differ_bend: float = 1.3
    """Added to that for ways [rad/m]: two wheels of 0.1 m on a narrow track may differ so much."""
    one_sided: float = 0.5
    """Share of a turn that shows as a way of the robot when one encoder does not count."""


PARAMS = DriveParams()


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
        self.own = list(own)
        """Where the lidar sees the robot itself; once it has turned round, measured."""
        self._body = Body(footprint)
        self._half_track_m = half_track_m
        self._speed_mps = min(PARAMS.speed_mps, speed_mps)
        self._turn_radps = min(PARAMS.turn_radps, turn_radps)
        self._circle_radps = min(PARAMS.circle_radps, PARAMS.circle_share * turn_radps)
        self._limit_radps = turn_radps
        self._lidar, self._wheels, self._mount = LidarTrack(), WheelCount(), Mount()
        self._line = _Line()
        self._now_ns = 0
        self._begun_ns: int | None = None
        self._driven_ns = 0
        self._command = Twist2D.zero()
        self._num_fast = self._num_plain = 0
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
        if self._begun_ns is None:
            self._begun_ns = now_ns
        elif not self._command.is_zero:
            self._driven_ns += now_ns - self._now_ns
        self._now_ns = now_ns
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
        if command != self._command:
            self.record.commands.append(Command(now_ns, command))
            self._command = command
        return command

    @property
    def echoes(self) -> Floats:
        """What the lidar has seen at the last stand (n, 2), in frame `laser` [m]."""
        beams = self._lidar.beams
        assert beams is not None
        return beams.points(self.record.stands[-1].ranges, beams.outside([]))

    def give_up(self, problem: str) -> None:
        """End it, with the reason."""
        self.has_ended = True
        self.problem = self.problem or problem

    # The course.
    def _drive(self, driving_s: float) -> Course:
        yield from self._stand()
        self._refuse_near()
        self.step_name = "a first short turn"
        yield from self._turn(PARAMS.trial_rad, PARAMS.trial_radps)
        yield from self._stand()
        self._judge_trial_turn()
        for number in range(2 * PARAMS.num_turns):
            self.step_name = f"turn {number + 1} of {2 * PARAMS.num_turns}"
            way = 1.0 if number < PARAMS.num_turns else -1.0
            yield from self._turn(way * PARAMS.turn_rad, self._turn_radps)
            yield from self._stand()
            self._judge()
            beyond = abs(self._moved().yaw) - PARAMS.turn_rad
            self._line.turn_lead_s = max(0.0, beyond / self._turn_radps)
            if number + 1 == PARAMS.num_turns:
                self._learn_own()
        half_m = self._find_room()
        yield from self._first_stroke()
        yield from self._creep()
        for number, share in enumerate(PARAMS.strokes):
            self.step_name = f"stroke {number + 1} of {len(PARAMS.strokes)}"
            yield from self._stroke(share * half_m)
        self._line.linear, self._line.angular = self._roughly_worth()
        middle_s = 0.5 * (self._driven_ns * 1e-9 + driving_s)
        for side, until_s in ((1.0, middle_s), (-1.0, driving_s)):
            while self._driven_ns < (until_s - PARAMS.least_round_s) * 1e9:
                yield from self._go_round(_Circle(half_m, side), until_s, driving_s)
                yield from self._stand()

    def _first_stroke(self) -> Course:
        """Drive a little ahead: the way that the lidar goes is ahead."""
        self.step_name = "a first short stroke"
        before = self._lidar.pose
        self._line.heading_rad = self._lidar.here.yaw
        self._line.start_T_first = self.record.stands[-1].start_T_laser
        until_ns = self._deadline(PARAMS.trial_m / PARAMS.trial_mps + PARAMS.patience_s)
        while before.distance_to(self._lidar.pose) < PARAMS.trial_m:
            self._refuse_late(until_ns, "The robot does not drive ahead as told")
            yield Twist2D(PARAMS.trial_mps, 0.0, 0.0)
        yield from self._stand()
        self._judge()
        first, last = self.record.stands[-2].start_T_laser, self.record.stands[-1].start_T_laser
        moved = first.inverse() @ last
        # Half of the turn on the way, since the robot drove an arc.
        direction = math.atan2(moved.y, moved.x) - 0.5 * moved.yaw
        if self._wheels.between_stands()[0] < 0.0:
            direction += math.pi
        self._mount.ahead = np.array([math.cos(direction), math.sin(direction)])
        beyond_m = math.hypot(moved.x, moved.y) - PARAMS.trial_m
        faster = max(0.0, self._speed_mps - PARAMS.trial_mps)
        self._line.lead_s = max(PARAMS.lead_s, beyond_m / PARAMS.trial_mps)
        self._line.lead_s += faster / (2.0 * PARAMS.motors_mps2)

    def _creep(self) -> Course:
        """Find the slowest speed at which the wheels turn."""
        self.step_name = "how slowly it can drive"
        for speed in PARAMS.creep_mps:
            until_ns = self._deadline(PARAMS.creep_s)
            middle_ns = self._deadline(0.5 * PARAMS.creep_s)
            way = None
            while self._now_ns < until_ns:
                if way is None and self._now_ns >= middle_ns:
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
        seen, last = 0.0, self._lidar.pose.yaw
        until_ns = self._deadline(abs(angle) / rate * 1.8 + PARAMS.patience_s)
        while seen < abs(angle):
            self._refuse_late(until_ns, "The robot does not turn as told")
            yield Twist2D(0.0, 0.0, math.copysign(rate, angle))
            now = self._lidar.pose.yaw
            seen += abs(angle_difference(now, last))
            last = now

    def _stroke(self, target_m: float) -> Course:
        """Drive straight until the robot is so far ahead of where the strokes began, and stand."""
        yield from self._turn_to(lambda: self._heading_error(target_m))
        way, length_m = self._way_to(target_m), abs(target_m - self._place[0])
        yield from self._go_to(target_m, self._speed_mps)
        yield from self._stand()
        self._judge()
        beyond_m = way * (self._place[0] - target_m)
        self._line.learn_lead(beyond_m, self._speed_mps, length_m)

    def _turn_to(self, error_of: Callable[[], float]) -> Course:
        """Turn to a heading, if another is far off.

        Args:
            error_of: how far the robot is turned to the left of it now [rad].
        """
        error = error_of()
        rate = PARAMS.trial_radps if abs(error) < PARAMS.trial_rad else self._turn_radps
        lead = max(0.02, self._line.turn_lead_s * rate)
        if abs(error) > max(PARAMS.heading_rad, lead):
            until_ns = self._deadline(abs(error) / rate + PARAMS.patience_s)
            while math.copysign(1.0, error) * error_of() > lead:
                self._refuse_late(until_ns, "The robot does not turn as told")
                yield Twist2D(0.0, 0.0, math.copysign(rate, -error))
            yield from self._stand()

    def _go_to(self, target_m: float, speed: float) -> Course:
        """Drive along the line until the robot is so far ahead of where the strokes began."""
        way, begun_ns = self._way_to(target_m), self._now_ns
        seconds = abs(target_m - self._place[0]) / speed
        until_ns = self._deadline(1.8 * seconds + PARAMS.patience_s)
        while way * (target_m - self._place[0]) > self._line.lead_s * speed:
            self._refuse_late(until_ns, "The robot does not drive as told")
            turn = -self._line.bend * way * speed
            if self._now_ns - begun_ns > 700_000_000:  # the start shows how the motors follow
                limit = PARAMS.most_steering_radps
                turn -= max(-limit, min(limit, PARAMS.steering * self._heading_error(target_m)))
            yield Twist2D(way * speed, 0.0, turn)

    def _go_round(self, circle: "_Circle", until_s: float, driving_s: float) -> Course:
        """Drive rounds on a circle, until it is time to stand or the robot is too far outside.

        Args:
            circle: it.
            until_s: when it is to be over at the latest, as time of driving [s].
            driving_s: when the whole drive is [s].
        """
        yield from self._turn_to(lambda: self._circle_error(circle)[0])
        speed = min(self._speed_mps, self._circle_radps * circle.radius_m)
        limit = PARAMS.most_steering_radps
        trim, last_ns = 0.0, self._now_ns
        most_m = max(PARAMS.off_circle_m, self._circle_error(circle)[1] + PARAMS.farther_m)
        was_at, moved_by_ns = self._place, self._deadline(PARAMS.patience_s)
        until_ns = self._deadline(PARAMS.rounds * 2.0 * math.pi * circle.radius_m / speed)
        while self._now_ns < until_ns and self._driven_ns < until_s * 1e9:
            self.step_name = f"circles, {driving_s - self._driven_ns * 1e-9:.0f} s left"
            self._refuse_late(moved_by_ns, "The robot does not drive in a circle as told")
            if math.dist(was_at, self._place) > PARAMS.moved_m:
                was_at, moved_by_ns = self._place, self._deadline(PARAMS.patience_s)
            error, outside_m = self._circle_error(circle)
            if outside_m > most_m:
                return
            trim -= PARAMS.circle_trim * error * (self._now_ns - last_ns) * 1e-9
            trim, last_ns = max(-limit, min(limit, trim)), self._now_ns
            steering = max(-limit, min(limit, trim - PARAMS.circle_steering * error))
            turn = self._line.turn_for(speed, circle, steering)
            yield Twist2D(speed, 0.0, max(-self._limit_radps, min(self._limit_radps, turn)))

    def _stand(self) -> Course:
        """Come to rest, and note where."""
        until_ns = self._deadline(PARAMS.stand_s)
        for _ in range(PARAMS.tries):
            scans = yield from self._rest(until_ns)
            assert self._lidar.beams is not None  # there are scans
            if moving_share(self._lidar.beams, scans) <= SIGHT.moving_share:
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
        start_T_laser, ranges, is_plain = self._lidar.note_stand(scans, self.own, len(stands))
        self._refuse_plain(is_plain)
        since_ns = self._wheels.still_since_ns
        assert since_ns is not None
        self._wheels.note_stand()
        stands.append(Stand(since_ns, _last_ns(scans[-1]), start_T_laser, ranges, is_plain))

    def _refuse_plain(self, is_plain: bool) -> None:
        """Refuse a place that is plain all round; a lidar that looks ahead may face one wall."""
        self._num_plain = self._num_plain + 1 if is_plain else 0
        is_turning = self._mount.ahead is None
        if self._num_plain > (PARAMS.most_plain if is_turning else 0):
            raise SetupRefused(
                "The lidar sees too few different walls here, as in a plain corridor, to tell how "
                "the robot moves. Choose a place with walls or furniture in several directions."
            )

    # What it sees of itself and of the room.
    def _refuse_near(self) -> None:
        """Refuse what is near and what nobody has called a part of the robot."""
        beams, ranges = self._lidar.beams, self.record.stands[0].ranges
        assert beams is not None
        reach_m = 2.0 * self._body.radius_m
        for sector in near_sectors(beams, ranges, reach_m + CLEARANCE.turn_margin_m):
            if not is_within(sector, self.own):
                first, last = map(math.degrees, sector)
                raise SetupRefused(
                    f"Something is nearer than {reach_m + CLEARANCE.turn_margin_m:.2f} m to the "
                    f"lidar, at its angles from {first:.0f}° to {last:.0f}°. Give the robot more "
                    "room."
                )

    def _learn_own(self) -> None:
        """Learn where the axle is, and what has turned with the robot."""
        stands, beams = self.record.stands, self._lidar.beams
        assert beams is not None
        self._mount.axle = axle_of([one.start_T_laser for one in stands if not one.is_plain])
        found = own_sectors(beams, stands, 2.0 * self._body.radius_m)
        for sector in self.own:
            if not is_within(sector, found) and not any(is_within(one, [sector]) for one in found):
                first, last = map(math.degrees, sector)
                raise SetupRefused(
                    f"What the lidar saw near it, at its angles from {first:.0f}° to {last:.0f}°, "
                    "did not turn with the robot, so it is no part of it. Clear the floor."
                )
        self.own = found

    def _find_room(self) -> float:
        """Return how far strokes may reach; refuse where there is too little room."""
        stands, beams = self.record.stands, self._lidar.beams
        assert beams is not None
        assert self._mount.axle is not None
        here = stands[-1].start_T_laser
        room = Room(here.transform_points(self._mount.axle[None])[0])
        keep = beams.outside(self.own)
        for stand in stands:
            room.add(stand.start_T_laser.transform_points(beams.points(stand.ranges, keep)))
        if room.blind:
            raise SetupRefused(
                "In some directions the lidar sees nothing at all, so nobody knows whether the "
                "floor is free there. Choose a place with walls around, away from glass and from "
                "what is black or shiny."
            )
        half_m = min(PARAMS.half_stroke_m, room.free_m - self._body.radius_m - CLEARANCE.margin_m)
        if half_m < PARAMS.least_half_m:
            needed_m = PARAMS.least_half_m + self._body.radius_m + CLEARANCE.margin_m
            raise SetupRefused(
                f"The nearest thing is {room.free_m:.2f} m from the middle of the robot; it needs "
                f"{needed_m:.2f} m all round. Give it more room."
            )
        return half_m

    # Judging what it did.
    def _judge_trial_turn(self) -> None:
        (way, turn), moved = self._wheels.between_stands(), self._moved()
        if abs(turn) < 0.25 * PARAMS.trial_rad and abs(way) < 0.02:
            raise SetupRefused(
                "The robot turned, but the wheels counted nothing: look at the encoders' cables."
            )
        if turn < 0.0:
            raise SetupRefused(
                "The wheels counted a turn to the right when told to turn to the left: left and "
                "right are swapped, or both encoders count backwards."
            )
        one_sided = way / (self._half_track_m * turn)
        if abs(one_sided) > PARAMS.one_sided:
            side = "left" if one_sided > 0.0 else "right"
            raise SetupRefused(
                f"On a turn only one wheel counted: the encoder of the {side} wheel does not "
                "count, or that wheel does not turn."
            )
        self._mount.sign = math.copysign(1.0, moved.yaw)
        self._judge()

    def _judge(self) -> None:
        """Refuse a stretch that wheels and lidar saw quite differently."""
        (way, turn), moved = self._wheels.between_stands(), self._moved()
        turned = self._mount.sign * moved.yaw
        off = abs(math.remainder(turned - turn, 2.0 * math.pi))
        if off > PARAMS.differ * abs(turn) + PARAMS.differ_rad + PARAMS.differ_bend * abs(way):
            raise SetupRefused(
                f"The wheels counted a turn by {math.degrees(turn):.0f}°, and the lidar saw "
                f"{math.degrees(turned):.0f}°: the wheels slip, a wheel's size or the track is "
                "far from what is set, or somebody moved the robot."
            )
        if abs(turn) > 0.4:
            return
        seen_m = math.hypot(moved.x, moved.y)
        if abs(seen_m - abs(way)) > PARAMS.differ * abs(way) + PARAMS.differ_m + 0.4 * abs(turn):
            raise SetupRefused(
                f"The wheels counted {abs(way):.2f} m, and the lidar saw {seen_m:.2f} m: the "
                "wheels slip, their size is far from what is set, or somebody moved the robot."
            )
        if abs(way) > 0.5 * PARAMS.trial_m:
            share = abs(way) / (abs(way) + PARAMS.bend_m)
            self._line.bend += share * ((turned - turn) / way - self._line.bend)

    def _refuse_late(self, until_ns: int, what: str) -> None:
        if self._now_ns > until_ns:
            raise SetupRefused(f"{what}: {self._why_not()}")

    def _why_not(self) -> str:
        """Say what wheels and lidar saw of the last command."""
        if not self.record.stands:
            return "the wheels or the lidar's picture never come to rest."
        last = self.record.stands[-1]
        wheels = self.record.wheel_motions()
        part = wheels.between(last.middle_ns, self._now_ns)
        turns = abs(float(np.sum(wheels.turn[part]))) > 0.1
        drives = abs(float(np.sum(wheels.way[part]))) > 0.03
        seen = self._lidar.since_stand
        moves = math.hypot(seen.x, seen.y) > 0.05 or abs(seen.yaw) > 0.1
        if not (turns or drives or moves):
            return (
                "the wheels do not turn. Is the motors' power on, and is the stop button released?"
            )
        if not moves:
            return (
                "the wheels turn, but the lidar sees no motion. The wheels slip, or are not on the "
                "floor."
            )
        if not (turns or drives):
            return "it moves, but the wheels count nothing. Look at the encoders' cables."
        return (
            "lidar and wheels see it move otherwise. One wheel may turn the wrong way round, or "
            "something holds the robot."
        )

    # What is always watched.
    def _take(
        self, motions: Sequence[MotionSample], scans: Sequence[LidarScan], imu: Sequence[Imu]
    ) -> None:
        for motion in motions:
            self.record.motions.append(motion)
            self._wheels.take(motion, is_to_stand=self._command.is_zero)
        self.record.imu.extend(imu)
        for scan in scans:
            if self._lidar.take(scan):
                self._follow(scan)
                self.record.waypoints.append(Waypoint(scan.stamp_ns, self._lidar.pose))

    def _follow(self, scan: LidarScan) -> None:
        self._refuse_too_fast(self._lidar.follow(scan, self.own))
        if not self._command.is_zero:
            beams = Beams.of(scan)
            points = beams.points(scan.ranges, beams.outside(self.own))
            stopping_m = self._line.lead_s * abs(self._command.vx)
            self._body.refuse_obstacle(points, self._mount, self._command, stopping_m)

    def _refuse_too_fast(self, twist: Twist2D) -> None:
        told_wz = max(abs(one.wz) for one in self._told_lately())
        axle = self._mount.axle
        lever = 0.5 if axle is None else float(np.hypot(*axle)) + 0.05
        most_wz = PARAMS.too_fast * told_wz + 0.3
        # In a corridor the lidar does not see how fast it goes along it: that is told later.
        most_v = PARAMS.too_fast * self._speed_mps + lever * abs(twist.wz) + 0.1
        is_fast = abs(twist.wz) > most_wz or twist.speed > most_v
        self._num_fast = self._num_fast + 1 if is_fast else 0
        if self._num_fast >= PARAMS.num_fast:
            raise SetupRefused(
                "The robot moves much faster than told: an encoder may be dead or count backwards, "
                "so that the board drives its wheel harder and harder; or somebody carries it."
            )

    def _told_lately(self) -> list[Twist2D]:
        """Return the commands that the robot may still be following."""
        found = [self._command]
        since_ns = self._now_ns - round(PARAMS.follows_s * 1e9)
        for command in reversed(self.record.commands):
            found.append(command.twist)
            if command.stamp_ns < since_ns:
                break
        return found

    def _watch(self) -> None:
        """Refuse to go on without the devices."""
        assert self._begun_ns is not None
        motions = self.record.motions
        heard_ns = max(self._begun_ns, motions[-1].stamp_ns if motions else 0)
        refuse_silence("motor board", heard_ns, self._now_ns)
        refuse_silence("lidar", max(self._begun_ns, self._lidar.latest_ns), self._now_ns)

    # Figures.
    def _deadline(self, seconds: float) -> int:
        return self._now_ns + round(seconds * 1e9)

    def _way_to(self, target_m: float) -> float:
        """Return whether a stroke leads ahead, 1, or back, -1."""
        return math.copysign(1.0, target_m - self._place[0])

    def _heading_error(self, target_m: float) -> float:
        """How far the robot is turned to the left of where a stroke should lead [rad].

        Off the line it should lead back to it.
        """
        turned = angle_difference(self._lidar.here.yaw, self._line.heading_rad)
        along, aside = self._place
        limit = PARAMS.most_return_rad
        back = aside / max(PARAMS.return_m, abs(target_m - along))
        back = self._way_to(target_m) * max(-limit, min(limit, back))
        return self._mount.sign * turned + back

    def _circle_error(self, circle: "_Circle") -> tuple[float, float]:
        """How far the robot is turned to the left of where a circle leads [rad], and outside [m].

        Off the circle it should lead back to it.
        """
        along, aside = self._place
        outside_m = math.hypot(along, aside) - circle.radius_m
        limit = PARAMS.most_return_rad
        back = max(-limit, min(limit, outside_m / PARAMS.circle_return_m))
        wanted = math.atan2(aside, along) + circle.side * (0.5 * math.pi + back)
        turned = self._mount.sign * angle_difference(self._lidar.here.yaw, self._line.heading_rad)
        return angle_difference(turned, wanted), outside_m

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

    @property
    def _place(self) -> tuple[float, float]:
        """How far the robot is ahead of where the strokes began, and to the left of it [m]."""
        axle = self._mount.axle
        assert self._mount.ahead is not None
        assert axle is not None
        moved = self._line.start_T_first.inverse() @ self._lidar.here
        x, y = (moved.transform_points(axle[None])[0] - axle).tolist()
        ahead_x, ahead_y = self._mount.ahead.tolist()
        return ahead_x * x + ahead_y * y, self._mount.sign * (ahead_x * y - ahead_y * x)

    def _moved(self) -> Pose2D:
        stands = self.record.stands
        return stands[-2].start_T_laser.inverse() @ stands[-1].start_T_laser


@dataclass(frozen=True, slots=True)
class _Circle:
    """Around where strokes began; its middle lies to the left of the robot, 1, or the right, -1."""

    radius_m: float
    side: float


@dataclass(slots=True)
class _Line:
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

    def turn_for(self, speed: float, circle: "_Circle", steering: float) -> float:
        """Return the turn rate to command on a circle [rad/s].

        Args:
            speed: that is commanded [m/s].
            circle: where the robot goes round.
            steering: how much faster it should turn to the left, really [rad/s].
        """
        turning = circle.side * speed * self.linear / circle.radius_m
        return (turning + steering) / self.angular - self.bend * speed

    def learn_lead(self, beyond_m: float, speed: float, length_m: float) -> None:
        """Learn from a stroke, but not from one too short to gather speed.

        Args:
            beyond_m: how far it led beyond its end [m].
            speed: at which it was told to go [m/s].
            length_m: from where it began to its end [m].
        """
        if length_m > self.lead_s * speed + speed**2 / (2.0 * PARAMS.motors_mps2):
            self.lead_s = max(0.0, self.lead_s + 0.5 * beyond_m / speed)


def _duration_ns(scan: LidarScan) -> int:
    return round(max(len(scan.ranges) - 1, 0) * scan.time_increment * 1e9)


def _first_ns(scan: LidarScan) -> int:
    """Return when the first of its beams was measured."""
    return scan.stamp_ns + min(0, _duration_ns(scan))


def _last_ns(scan: LidarScan) -> int:
    """Return when the last of its beams was measured."""
    return scan.stamp_ns + max(0, _duration_ns(scan))
