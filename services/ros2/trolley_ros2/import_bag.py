"""A recording of Trolley from a bag: two passes, of which the first finds what there is."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Clock, Odometry, Robot, Scan, Transform
from trolley.recording.layout import split_key
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.topics import Topic
from trolley_ros2 import cdr
from trolley_ros2.bag import BadBag, Bag, Channel, NotRead
from trolley_ros2.from_bag import (
    Frames,
    NotTaken,
    Stamps,
    frame_name,
    is_base,
    is_tf,
    moving_base,
    odometry_of,
    odometry_of_transform,
    scan_of,
    split_mount,
    stamp_of,
)

CLOCK_NS = 100_000_000
BEFORE_NS = 1_000_000_000
"""By so much robot time begins before the first message: nothing may be stamped earlier."""
MAX_SPEED_MPS, MAX_TURN_RADPS, DECELERATION_MPS2 = 1.0, 2.0, 1.0
"""What a recorded robot claims; nothing is driven with it."""


@dataclass(frozen=True)
class Wishes:
    """What the command line says, None where the bag decides."""

    scan: str | None = None
    odom: str | None = None
    laser: Pose2D | None = None
    radius_m: float = 0.2


@dataclass
class Survey:
    """What is in a bag."""

    counts: Counter[Channel] = field(default_factory=Counter[Channel])
    frames: Frames = field(default_factory=Frames)
    heads: dict[Channel, tuple[str, str]] = field(default_factory=dict[Channel, tuple[str, str]])
    """Frame and child frame of the first message of each scan and odometry topic."""
    moving: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    """Transforms by frame and child, of those that say where a robot's body is."""
    unread: Counter[Channel] = field(default_factory=Counter[Channel])
    why: dict[Channel, str] = field(default_factory=dict[Channel, str])


@dataclass
class Outcome:
    """What was taken, and what was not and why."""

    taken: dict[str, str] = field(default_factory=dict[str, str])
    """By topic, what it became."""
    left: dict[str, str] = field(default_factory=dict[str, str])
    """By topic, why not."""
    notes: list[str] = field(default_factory=list[str])
    seconds: float = 0.0


def convert(bag: Bag, robot: str, path: Path, wishes: Wishes) -> Outcome:
    """Write a recording of a robot from a bag.

    Raises:
        BadBag: It lacks something; the text says what. No file is left.
        OSError: The file cannot be written.
    """
    found = survey(bag)
    if any(split_key(one.topic) is not None for one in found.counts):
        raise BadBag(
            "is a recording of Trolley already: `trolley replay` and `trolley demo --recording` "
            "play it, `trolley export bag` makes a bag of it"
        )
    try:
        scan = _chosen(found, wishes.scan, cdr.LASER_SCAN, "--scan")
        odom = _chosen_odometry(found, wishes.odom)
    except BadBag as error:
        raise BadBag(" ".join([f"{error}.", *bag.damage]) if bag.damage else str(error)) from error
    laser_frame = found.heads[scan][0]
    odom_frame, base = found.heads[odom]
    try:
        mount, is_inverted, mounted = _mount(found, wishes, laser_frame, base)
    except NotTaken as error:
        raise BadBag(f"the lidar's place cannot be taken: {error}") from error
    outcome = Outcome()
    with RecordingWriter(path, robot, {"from": "a bag"}) as writer:
        run = _Run(Recorder(writer, robot), robot)
        try:
            run.begin = _about(robot, mount, wishes.radius_m)
            _copy(bag, run, (scan, odom), (odom_frame, is_inverted))
            run.check()
            writer.finish()
        except (BadBag, OSError):
            path.unlink()
            raise
    outcome.seconds = run.seconds
    outcome.taken[scan.topic] = f"scan: {run.counts[Scan]} of {found.counts[scan]}"
    what = f"from {odom_frame} -> {base}" if is_tf(odom) else f"of {found.counts[odom]}"
    outcome.taken.setdefault(odom.topic, f"odom: {run.counts[Odometry]} {what}")
    for channel in found.counts:
        if channel.topic not in outcome.taken:
            outcome.left[channel.topic] = _why_not(channel, found)
    outcome.notes = [mounted, *run.sentences(), *bag.damage]
    return outcome


def survey(bag: Bag) -> Survey:
    """Look at all of a bag."""
    found = Survey()
    for message in bag.messages():
        channel = message.channel
        found.counts[channel] += 1
        wanted = channel.type_name in (cdr.LASER_SCAN, cdr.ODOMETRY)
        if not is_tf(channel) and (not wanted or channel in found.heads):
            continue
        try:
            content = bag.read(message)
            if is_tf(channel):
                found.frames.add(content)
                for one in content.transforms:
                    child = frame_name(one.child_frame_id)
                    if is_base(child) and not channel.topic.endswith("static"):
                        found.moving[frame_name(one.header.frame_id), child] += 1
                        found.heads.setdefault(channel, (frame_name(one.header.frame_id), child))
            else:
                child = frame_name(getattr(content, "child_frame_id", "")) or "base_link"
                found.heads[channel] = frame_name(content.header.frame_id), child
        except (NotRead, AttributeError) as error:
            found.unread[channel] += 1
            found.why[channel] = str(error)
    return found


def _chosen(found: Survey, wish: str | None, type_name: str, option: str) -> Channel:
    fitting = [one for one in found.counts if one.type_name == type_name]
    if wish is not None:
        named = [one for one in fitting if one.topic.strip("/") == wish.strip("/")]
        if not named:
            there = ", ".join(one.topic for one in fitting) or "none"
            raise BadBag(f"there is no {type_name} {wish!r} ({option}); the bag has {there}")
        fitting = named
    good = [one for one in fitting if one in found.heads]
    if not good:
        why = next((found.why[one] for one in fitting if one in found.why), None)
        there = ", ".join(f"{one.topic} ({one.type_name})" for one in found.counts) or "nothing"
        raise BadBag(why or f"there is no {type_name} in the bag, which holds {there}")
    return max(good, key=lambda one: found.counts[one])


def _chosen_odometry(found: Survey, wish: str | None) -> Channel:
    """The topic of odometry; without one that of transforms which move the body."""
    named = wish is not None and any(
        is_tf(one) and one.topic.strip("/") == wish.strip("/") for one in found.heads
    )
    has_topic = any(one.type_name == cdr.ODOMETRY for one in found.heads)
    if (wish is None and not has_topic) or named:
        moving = [one for one in found.heads if is_tf(one)]
        frames = [pair for pair, _ in found.moving.most_common() if _is_odom(pair[0])]
        if moving and frames:
            found.heads[moving[0]] = frames[0]
            return moving[0]
    return _chosen(found, wish, cdr.ODOMETRY, "--odom")


def _is_odom(frame: str) -> bool:
    return frame.rpartition("/")[2].startswith("odom")


def _mount(found: Survey, wishes: Wishes, laser: str, base: str) -> tuple[Transform, bool, str]:
    if wishes.laser is not None:
        pose, z, is_inverted, source = wishes.laser, 0.0, False, "--laser"
    else:
        pose, z, is_inverted = split_mount(found.frames.mount(laser, base))
        source = f"{base} -> {laser}"
    text = (
        f"The lidar sits at x {pose.x:.3f} m, y {pose.y:.3f} m, yaw {pose.yaw:.3f} rad"
        f"{', upside down' if is_inverted else ''} ({source})."
    )
    mount = Transform(stamp_ns=0, parent="base_link", child="laser", pose=pose, z=z)
    return mount, is_inverted, text


def _about(robot: str, mount: Transform, radius_m: float) -> list[tuple[Any, str]]:
    corners = [(radius_m, radius_m), (-radius_m, radius_m), (-radius_m, -radius_m)]
    about = Robot(
        stamp_ns=0,
        name=robot,
        title=robot,
        footprint=[*corners, (radius_m, -radius_m)],
        drive="differential",
        max_speed=MAX_SPEED_MPS,
        max_wz=MAX_TURN_RADPS,
        deceleration=DECELERATION_MPS2,
    )
    return [
        (about, topics.ROBOT.key(robot)),
        (mount, topics.TF.key(robot, "laser")),
    ]


class _Run:
    """Writes messages in the order of the bag, in robot time: that of their stamps."""

    def __init__(self, recorder: Recorder, robot: str) -> None:
        self.counts: Counter[type] = Counter()
        self.dropped: Counter[str] = Counter()
        self.begin: list[tuple[Any, str]] = []
        self._recorder = recorder
        self._robot = robot
        self._epoch_ns: int | None = None
        self._now_ns = 0
        self._clock_ns = 0

    @property
    def seconds(self) -> float:
        """How long the drive is."""
        return 0.0 if self._epoch_ns is None else (self._now_ns - self._epoch_ns - BEFORE_NS) * 1e-9

    def put(self, topic: Topic[Any], message: Scan | Odometry) -> None:
        """Add a message."""
        if self._epoch_ns is None:
            self._epoch_ns = max(0, message.stamp_ns - BEFORE_NS)
            self._now_ns = message.stamp_ns
            self._tick()
            for first, key in self.begin:
                self._take(key, msgspec.structs.replace(first, stamp_ns=self._now_ns))
        if message.stamp_ns < self._epoch_ns:
            raise NotTaken("stamped long before the first message")
        self._now_ns = max(self._now_ns, message.stamp_ns)
        if self._now_ns - self._clock_ns >= CLOCK_NS:
            self._tick()
        self._take(topic.key(self._robot), message)
        self.counts[type(message)] += 1

    def check(self) -> None:
        """Refuse a drive that lacks one of both.

        Raises:
            BadBag: There is nothing to play.
        """
        for kind, what in ((Scan, "scan"), (Odometry, "odometry")):
            if not self.counts[kind]:
                why = " ".join(self.sentences())
                raise BadBag(f"no {what} in the bag can be used. {why}".strip())

    def sentences(self) -> list[str]:
        """What was left out."""
        return [f"Left out: {number} {why}." for why, number in sorted(self.dropped.items())]

    def _tick(self) -> None:
        self._clock_ns = self._now_ns
        clock = Clock(stamp_ns=self._now_ns, rate=1.0, epoch=self._epoch_ns or 0)
        self._take(topics.CLOCK.key(self._robot), clock)

    def _take(self, key: str, message: Any) -> None:
        payload = codec.encode(message, "msgpack")
        sample = Sample(key, payload, codec.MIME["msgpack"])
        self._recorder.take(sample, self._now_ns, self._now_ns)


def _copy(bag: Bag, run: _Run, chosen: tuple[Channel, Channel], how: tuple[str, bool]) -> None:
    scan, odom = chosen
    odom_frame, is_inverted = how
    stamps = {scan: Stamps(), odom: Stamps()}
    before: Odometry | None = None
    for message in bag.messages():
        channel = message.channel
        # Transforms come by several topics or publishers; those that move are one topic's.
        if channel not in stamps:
            continue
        kind = "scans" if channel == scan else "odometry"
        try:
            content = bag.read(message)
            if channel == scan:
                stamps[scan].check(stamp_of(content), message.at_ns)
                run.put(topics.SCAN, scan_of(content, is_inverted=is_inverted))
                continue
            rows = moving_base(content.transforms, odom_frame) if is_tf(odom) else [content]
            for one in rows:
                stamps[odom].check(stamp_of(one), message.at_ns)
                found = odometry_of_transform(one, before) if is_tf(odom) else odometry_of(one)
                run.put(topics.ODOM, found)
                before = found
        except (NotRead, NotTaken, AttributeError) as error:
            run.dropped[f"{kind}: {error}"] += 1


def _why_not(channel: Channel, found: Survey) -> str:
    if channel in found.why:
        return found.why[channel]
    if is_tf(channel):
        return "only the lidar's place is taken from it"
    if channel.type_name in (cdr.LASER_SCAN, cdr.ODOMETRY):
        return "another topic was taken; --scan and --odom choose"
    if channel.type_name == cdr.OCCUPANCY_GRID:
        return "a map is not taken: use map_server's file with --map"
    return "Trolley records no such thing of a drive"
