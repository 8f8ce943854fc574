"""How the lidar sits and what the wheels' counts are worth, from motions of the lidar.

The lidar's own motion from stand to stand is the truth; long ways are cut where it was meanwhile.
With X = base_T_laser, and B the motion of the base that the wheels report with these scales,
X @ Z @ X^-1 = B for each motion Z of the lidar.
All stretches together give x, y and yaw of the lidar, the size of each wheel, the track, and the
play of the wheels, by least squares; each stretch counts by the slip that wheels usually have.

Source:
    Censi, Franchi, Marchionni, Oriolo, Simultaneous Calibration of Odometry and Sensor Parameters
    for Mobile Robots (2013), for the model; play and covariances are our own.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, compress, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, angle_difference, exp_twist
from trolley_base.setup.record import Record, SetupRefused, Stand, Waypoint, WheelMotions

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GeometryParams:
    """How much stretches of a drive tell; set by hand unless stated otherwise."""

    lidar_m: float = 0.002
    """Standard deviation of where standing scans are aligned [m]."""
    lidar_rad: float = 0.001
    """The same of their direction [rad]."""
    moving_m: float = 0.004
    """Standard deviation of where scans are aligned on the way [m]."""
    moving_rad: float = 0.003
    """The same of their direction [rad]."""
    long_m: float = 1.2
    """A stretch that is longer is cut into pieces [m]."""
    piece_m: float = 0.45
    """Their length [m]: what the wheels slip in it is much more than what the lidar errs."""
    slip_m: float = 0.02
    """Standard deviation of the way after a metre, a random walk [m]: hard wheels on tiles."""
    slip_rad: float = 0.03
    """Standard deviation of the heading after a metre or a radian, a random walk [rad]."""
    castor_rad: float = 0.035
    """Standard deviation of how a castor that swings round turns the robot [rad]."""
    play_m: float = 0.002
    """Play of a wheel before anything is known [m]."""
    play_std: float = 0.003
    """Its standard deviation [m]."""
    on_spot_m: float = 0.05
    """A turn on the spot leads less far [m]; on the way, wheels of two sizes may count a turn to
    the left where the robot goes to the right."""
    castor_m: float = 0.02
    """A castor has swung round after this way [m]."""
    castor_turn_rad: float = 0.3
    """It stands aside after such a turn on the spot [rad]."""
    scale_std: float = 0.15
    """Standard deviation of how wrong settings are, before anything is known."""
    arc_steps: int = 6
    """Number of places on a stretch at which it is taken to slip."""
    step: float = 1e-5
    """Step of the numeric derivative [m, rad]."""
    iterations: int = 15
    """Number of Gauss-Newton steps at most."""
    least_misfit: float = 0.5
    """Deviations are not taken to be smaller than this share of what is usual: what errs in the
    same way all the time makes nothing miss."""
    odd_stretch: float = 8.0
    """A stretch that misses by so many standard deviations was disturbed."""
    most_odd_pieces: int = 2
    """So many pieces of a way that were disturbed are left out: where scans get lost, the lidar's
    motion may be followed wrongly by some centimetres, which the next stand puts right."""
    least_turn_rad: float = 1.0
    """A stretch that turns more is one that shows how the robot turns [rad]."""
    least_way_m: float = 0.2
    """A stretch that leads farther is one that shows where ahead is [m]."""


PARAMS = GeometryParams()
X, Y, YAW, LEFT, RIGHT, TRACK, PLAY = range(7)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured value and its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Geometry:
    """How the robot is built.

    Attributes:
        x, y: the lidar's place in `base_link` [m].
        yaw: the direction of its angle 0 there [rad].
        is_mirrored: the lidar turns the other way than its driver believes.
        left, right: true metres per metre that the wheel counts.
        track: true distance between the wheels over the one that the board assumes.
        linear: true metres per reported metre, the mean of both wheels.
        angular: true radians per reported radian.
        wheel_ratio: the right wheel's diameter over the left one's.
        play: how far a wheel turns before it moves the robot, when its direction changes [m].
        misfit: by how much stretches miss, over what was expected; 1 is usual.
    """

    x: Estimate
    y: Estimate
    yaw: Estimate
    is_mirrored: bool
    left: Estimate
    right: Estimate
    track: Estimate
    linear: Estimate
    angular: Estimate
    wheel_ratio: Estimate
    play: Estimate
    misfit: float

    @property
    def base_T_laser(self) -> Pose2D:
        """The lidar's pose."""
        return Pose2D(self.x.value, self.y.value, self.yaw.value)

    @property
    def slip_m(self) -> float:
        """Standard deviation of how far the wheels slip in a metre, as they did [m]."""
        return PARAMS.slip_m * max(self.misfit, PARAMS.least_misfit)


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """What happened between two stands, or on a piece of a long way.

    Attributes:
        start_ns, end_ns: when [robot time].
        part: of what the wheels counted.
        seen: motion of the lidar, as it is, not as in a mirror.
        way: distance that the wheels count [m].
        turn: angle that they count [rad].
        swings: whether a castor swings round: the robot goes the other way than before, or has
            turned on the spot.
        is_plain: the lidar saw too little at one of its ends to tell how far it went.
        is_piece: the lidar did not stand at its ends.
    """

    start_ns: int
    end_ns: int
    part: slice
    seen: Pose2D
    way: float
    turn: float
    swings: bool
    is_plain: bool = False
    is_piece: bool = False

    @property
    def seen_turn(self) -> float:
        """The turn that the lidar saw [rad], more than half a turn, too, if the wheels say so."""
        return self.turn + angle_difference(self.seen.yaw, self.turn)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A drive, cut at its stands, and long ways between them into pieces.

    Attributes:
        left, right: (n,) distances that the wheels counted [m].
        stretches: all of it.
        half_track_m: half of the track that the board calculates with [m].
        is_mirrored: the lidar turns the other way than its driver believes.
    """

    left: Floats
    right: Floats
    stretches: list[Stretch]
    half_track_m: float
    is_mirrored: bool


def mirrored(pose: Pose2D) -> Pose2D:
    """Return a pose as it is seen in a mirror along x."""
    return Pose2D(pose.x, -pose.y, -pose.yaw)


def cut(record: Record, half_track_m: float) -> Drive:
    """Cut a drive at its stands.

    Args:
        record: the drive.
        half_track_m: half of the track that the board calculates with [m].

    Raises:
        SetupRefused: the drive has no turn.
    """
    wheels = record.wheel_motions()
    is_mirrored = find_mirror(record)
    cuts = [
        cut
        for before, after in pairwise(record.stands)
        for cut in _cuts(record.waypoints, wheels, before, after)
    ]
    wheels = wheels.split_at(np.array([cut.end_ns for cut in cuts], np.int64))
    found: list[Stretch] = []
    went = 0.0
    for one in cuts:
        part = wheels.between(one.start_ns, one.end_ns)
        way, turn = float(np.sum(wheels.way[part])), float(np.sum(wheels.turn[part]))
        seen = mirrored(one.seen) if is_mirrored else one.seen
        swings = way * went <= 0.0
        found.append(
            Stretch(
                one.start_ns, one.end_ns, part, seen, way, turn, swings, one.is_plain, one.is_piece
            )
        )
        if abs(way) > PARAMS.castor_m:
            went = way
        elif abs(turn) > PARAMS.castor_turn_rad:
            went = 0.0
    return Drive(
        wheels.way - half_track_m * wheels.turn,
        wheels.way + half_track_m * wheels.turn,
        found,
        half_track_m,
        is_mirrored,
    )


class _Cut(NamedTuple):
    start_ns: int
    end_ns: int
    seen: Pose2D
    """Motion of the lidar, perhaps as in a mirror."""
    is_plain: bool
    is_piece: bool


def _cuts(
    waypoints: Sequence[Waypoint], wheels: WheelMotions, before: Stand, after: Stand
) -> Iterator[_Cut]:
    """Yield the whole stretch between two stands, or its pieces if it is long."""
    is_plain = before.is_plain or after.is_plain
    part = wheels.between(before.middle_ns, after.middle_ns)
    way_m = np.cumsum(np.abs(wheels.way[part]))
    on_way = [one for one in waypoints if before.middle_ns <= one.stamp_ns <= after.middle_ns]
    if not len(way_m) or way_m[-1] < PARAMS.long_m or len(on_way) < 2:
        seen = before.start_T_laser.inverse() @ after.start_T_laser
        yield _Cut(before.middle_ns, after.middle_ns, seen, is_plain, False)
        return
    gone = np.interp([one.stamp_ns for one in on_way], wheels.stamps_ns[part], way_m)
    last = 0
    for index in range(1, len(on_way)):
        is_end = index == len(on_way) - 1
        if gone[index] - gone[last] < PARAMS.piece_m and not is_end:
            continue
        if gone[-1] - gone[index] < 0.5 * PARAMS.piece_m and not is_end:
            continue
        start, end = on_way[last], on_way[index]
        seen = start.start_T_laser.inverse() @ end.start_T_laser
        yield _Cut(start.stamp_ns, end.stamp_ns, seen, is_plain, True)
        last = index


def find_mirror(record: Record) -> bool:
    """Say whether the lidar sees the robot turn the other way than the wheels.

    Raises:
        SetupRefused: the drive has no turn.
    """
    wheels = record.wheel_motions()
    agreement = 0.0
    for before, after in pairwise(record.stands):
        part = wheels.between(before.middle_ns, after.middle_ns)
        way, turn = float(np.sum(wheels.way[part])), float(np.sum(wheels.turn[part]))
        seen = angle_difference(after.start_T_laser.yaw, before.start_T_laser.yaw)
        if abs(way) < PARAMS.on_spot_m and 0.2 < abs(turn) < 0.9 * math.pi:
            agreement += math.copysign(seen, turn * seen)
    if agreement == 0.0:
        raise SetupRefused("The robot has not turned, so nothing shows how the lidar sits.")
    return agreement < 0.0


def fit(drive: Drive) -> Geometry:
    """Find what fits all stretches best.

    Raises:
        SetupRefused: a stretch was disturbed, or there is no turn or no straight one.
    """
    # How the wheels' play lay at the beginning is not known.
    parts = [part for part in drive.stretches[1:] if not part.is_plain]
    theta, normal, misses = _solved(drive, parts)
    odd = _are_odd(misses)
    are_pieces = all(part.is_piece for part in compress(parts, odd))
    if are_pieces and 0 < sum(odd) <= PARAMS.most_odd_pieces:
        parts = [part for part, is_odd in zip(parts, odd, strict=True) if not is_odd]
        theta, normal, misses = _solved(drive, parts)
        odd = _are_odd(misses)
    if any(odd):
        raise SetupRefused(_disturbed(drive, parts[int(np.argmax(misses))], theta))
    misfit = _misfit(misses)
    spread = np.linalg.inv(normal) * max(misfit, PARAMS.least_misfit) ** 2
    return _geometry(theta, np.asarray(spread, np.float64), misfit, drive.is_mirrored)


def _solved(drive: Drive, parts: Sequence[Stretch]) -> tuple[Floats, Floats, Floats]:
    """Return theta (7,), what is known of it (7, 7), and by how much each stretch misses (n,)."""
    theta = _first_guess(parts)
    prior = np.array([1.0, 1.0, math.pi, *[PARAMS.scale_std] * 3, PARAMS.play_std])
    information = np.diag(prior**-2)
    centre = theta.copy()
    for _ in range(PARAMS.iterations):
        errors, slopes = _errors(drive, parts, theta)
        normal = information + slopes.T @ slopes
        gradient = slopes.T @ errors + information @ (theta - centre)
        change = np.linalg.solve(normal, gradient)
        theta = theta - change
        theta[YAW] = math.remainder(theta[YAW], 2.0 * math.pi)
        theta[PLAY] = max(0.0, theta[PLAY])
        if np.max(np.abs(change)) < 1e-6:
            break
    errors, slopes = _errors(drive, parts, theta)
    normal = np.asarray(information + slopes.T @ slopes, np.float64)
    return theta, normal, np.linalg.norm(errors.reshape(-1, 3), axis=1)


def _misfit(misses: Floats) -> float:
    """Return how much stretches miss, as a share of what is usual."""
    # The median, since disturbed stretches must not excuse themselves; 1.54 is its usual value.
    return float(np.median(misses)) / 1.54


def _are_odd(misses: Floats) -> list[bool]:
    """Say of each stretch whether it misses by so much that it was disturbed."""
    return (misses > PARAMS.odd_stretch * max(1.0, _misfit(misses))).tolist()


def _geometry(theta: Floats, covariance: Floats, misfit: float, is_mirrored: bool) -> Geometry:
    def value(of: float, slope: Sequence[float]) -> Estimate:
        gradient = np.zeros(7)
        gradient[LEFT : TRACK + 1] = slope
        return Estimate(of, math.sqrt(max(0.0, float(gradient @ covariance @ gradient))))

    def single(index: int) -> Estimate:
        return Estimate(float(theta[index]), math.sqrt(float(covariance[index, index])))

    left, right, track = (float(theta[index]) for index in (LEFT, RIGHT, TRACK))
    linear = 0.5 * (left + right)
    return Geometry(
        x=single(X),
        y=single(Y),
        yaw=single(YAW),
        is_mirrored=is_mirrored,
        left=single(LEFT),
        right=single(RIGHT),
        track=single(TRACK),
        linear=value(linear, (0.5, 0.5, 0.0)),
        angular=value(linear / track, (0.5 / track, 0.5 / track, -linear / track**2)),
        wheel_ratio=value(right / left, (-right / left**2, 1.0 / left, 0.0)),
        play=single(PLAY),
        misfit=misfit,
    )


def _first_guess(parts: Sequence[Stretch]) -> Floats:
    parts = [part for part in parts if not part.is_piece]
    turns = [part for part in parts if abs(part.turn) > PARAMS.least_turn_rad]
    ways = [part for part in parts if abs(part.way) > PARAMS.least_way_m]
    if not turns or not ways:
        raise SetupRefused("The drive needs at least one turn and one straight stretch.")
    # What the lidar sees of a turn is the true angle but for whole turns.
    true = sum(abs(part.seen.yaw) for part in turns)
    track = sum(abs(part.turn) for part in turns) / max(true, 1e-3)
    linear = float(
        np.median([math.hypot(part.seen.x, part.seen.y) / abs(part.way) for part in ways])
    )
    direction = np.sum(
        [np.array([part.seen.x, part.seen.y]) * math.copysign(1.0, part.way) for part in ways],
        axis=0,
    )
    yaw = -math.atan2(direction[1], direction[0])
    place = _centre_of(turns, yaw)
    return np.array([place[0], place[1], yaw, linear, linear, linear * track, PARAMS.play_m])


def _centre_of(turns: Sequence[Stretch], yaw: float) -> Floats:
    """Return where the lidar sits by turns on the spot: (1 - R(turn)) p = -R(yaw) z."""
    rows: list[Floats] = []
    sums: list[Floats] = []
    for part in turns:
        rows.append(np.eye(2) - _rotation(part.seen.yaw))
        sums.append(-_rotation(yaw) @ np.array([part.seen.x, part.seen.y]))
    found, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(sums), rcond=None)
    return np.asarray(found, np.float64)


def turn_treads(counted: Floats, play: float) -> Floats:
    """Return how far the tread of a wheel goes, each time, when its motor turns (n,) [m].

    Args:
        counted: (n,) how far the encoder says that the wheel went [m].
        play: how far it turns, when its direction changes, before it moves the robot [m].
    """

    def taken_up(before: float, moved: float) -> float:
        return min(play, max(0.0, before + moved))

    within = np.array([*accumulate(counted.tolist(), taken_up, initial=0.0)])
    return within[:-1] + counted - within[1:]


def _treads(drive: Drive, play: float) -> tuple[Floats, Floats]:
    play = max(0.0, play)
    return turn_treads(drive.left, play), turn_treads(drive.right, play)


def _driven(
    part: Stretch, treads: tuple[Floats, Floats], theta: Floats, half_track_m: float
) -> tuple[float, float, float]:
    """Return the motion x, y, yaw of the base by the wheels."""
    left, right = theta[LEFT] * treads[0][part.part], theta[RIGHT] * treads[1][part.part]
    turn = (right - left) / (2.0 * half_track_m * theta[TRACK])
    way = 0.5 * (left + right)
    heading = np.cumsum(turn) - 0.5 * turn
    return (
        float(np.sum(way * np.cos(heading))),
        float(np.sum(way * np.sin(heading))),
        float(np.sum(turn)),
    )


def _seen(part: Stretch, theta: Floats) -> tuple[float, float, float]:
    """Return the motion of the base by the lidar."""
    base_T_laser = Pose2D(float(theta[X]), float(theta[Y]), float(theta[YAW]))
    moved = base_T_laser @ part.seen @ base_T_laser.inverse()
    return moved.x, moved.y, moved.yaw


def _misses(
    drive: Drive, parts: Sequence[Stretch], treads: tuple[Floats, Floats], theta: Floats
) -> Floats:
    """Return (n, 3) by how much wheels and lidar differ, x, y [m], yaw [rad]."""
    found = np.empty((len(parts), 3))
    for index, part in enumerate(parts):
        driven, seen = _driven(part, treads, theta, drive.half_track_m), _seen(part, theta)
        turn = math.remainder(seen[2] - driven[2], 2.0 * math.pi)
        found[index] = seen[0] - driven[0], seen[1] - driven[1], turn
    return found


def _weights(part: Stretch, theta: Floats) -> Floats:
    """Return W (3, 3) with W^T W the inverse covariance of a miss, in the frame at its start.

    Way and heading are random walks along the arc that was driven; a castor turns the robot at the
    beginning. What the lidar's direction errs by moves the base, too.
    """
    lidar_m, lidar_rad = PARAMS.lidar_m, PARAMS.lidar_rad
    if part.is_piece:
        lidar_m, lidar_rad = PARAMS.moving_m, PARAMS.moving_rad
    away, turned = abs(part.way), abs(part.turn)
    lever = math.hypot(theta[X], theta[Y])
    place = 2.0 * (lidar_m**2 + (lidar_rad * lever) ** 2)
    covariance = np.diag([place, place, 2.0 * lidar_rad**2])
    twist = Twist2D(part.way, 0.0, part.turn)
    end = exp_twist(twist)
    shares = (np.arange(PARAMS.arc_steps) + 0.5) / PARAMS.arc_steps
    for at in (exp_twist(twist, share) for share in shares.tolist()):
        along = np.array([math.cos(at.yaw), math.sin(at.yaw), 0.0])
        covariance += PARAMS.slip_m**2 * away / len(shares) * np.outer(along, along)
        turning = np.array([at.y - end.y, end.x - at.x, 1.0])
        walk = PARAMS.slip_rad**2 * (away + turned) / len(shares)
        covariance += walk * np.outer(turning, turning)
    if part.swings and away > 0.05:
        kick = np.array([-end.y, end.x, 1.0])
        covariance += PARAMS.castor_rad**2 * np.outer(kick, kick)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def _errors(drive: Drive, parts: Sequence[Stretch], theta: Floats) -> tuple[Floats, Floats]:
    """Return the weighted misses (3 n,) and their derivative (3 n, 7), the weights held."""
    weights = np.stack([_weights(part, theta) for part in parts])

    treads = _treads(drive, float(theta[PLAY]))  # slow, and only the play changes them

    def weighted(at: Floats) -> Floats:
        own = treads if at[PLAY] == theta[PLAY] else _treads(drive, float(at[PLAY]))
        return np.einsum("nij,nj->ni", weights, _misses(drive, parts, own, at)).ravel()

    columns: list[Floats] = []
    for index in range(7):
        step = np.zeros(7)
        step[index] = PARAMS.step
        columns.append((weighted(theta + step) - weighted(theta - step)) / (2.0 * PARAMS.step))
    return weighted(theta), np.column_stack(columns)


def _disturbed(drive: Drive, part: Stretch, theta: Floats) -> str:
    treads = _treads(drive, float(theta[PLAY]))
    driven, seen = _driven(part, treads, theta, drive.half_track_m), _seen(part, theta)
    return (
        f"On one stretch the wheels counted {driven[0]:.2f} m ahead and "
        f"{math.degrees(driven[2]):.0f}°, but the lidar saw {seen[0]:.2f} m and "
        f"{math.degrees(seen[2]):.0f}°: the wheels slipped, or somebody moved the robot. "
        "Measure again, on a floor that grips."
    )


def _rotation(angle: float) -> Floats:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
