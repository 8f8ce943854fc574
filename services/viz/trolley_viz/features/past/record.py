"""What was known of a robot at each moment: where it was, what it saw and what was said.

Times are those since this host was started [ns], which go on while it sleeps: neither the robot's
clock nor that of this host can put them out of order. What a clock on the wall showed is known only
by whoever shows them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar, get_args

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.messages import PoseState
from trolley_viz.features.past.rows import AT, Rows
from trolley_viz.robots.situation import is_asked_for
from trolley_viz.words.sentences import StatusLine, Tone

MAX_BEAMS = 120
"""Echoes of a scan that are kept."""
CM = 0.01
"""Echoes are kept in whole centimetres [m]."""
MAX_TEXTS = 2000
"""Sentences, goals and failures that are kept, of each."""
POSE_HOLDS_NS = 4_000_000_000
"""A robot stands where it was last seen this long; after that nobody knows where it was."""
SCAN_HOLDS_NS = 12_000_000_000
"""A scan is shown this long: while the robot stands there is one in 10 s."""
FAILURE_HOLDS_NS = 3_000_000_000
"""The failure of a stop stands this long before whatever came next."""
FIRST_HOLDS_NS = 4_000_000_000
"""The first sentence holds for this long before, too: poses are known a little earlier."""
MAX_STEP_M = 1.5
"""No robot drives so far between two samples: there it was carried, or found its place anew."""
TRACK_STEP_M = 0.05
MAX_TRACK = 400
"""How many points of a track are drawn."""

POSE = np.dtype(
    [
        (AT, "<i8"),
        ("robot_ns", "<i8"),
        ("x", "<f4"),
        ("y", "<f4"),
        ("yaw", "<f4"),
        ("state", "u1"),
        ("map", "<u2"),
    ]
)
"""A pose on a map [m, rad]; `robot_ns` is its time by the robot's clock."""
SCAN = np.dtype(
    [
        (AT, "<i8"),
        ("x", "<f4"),
        ("y", "<f4"),
        ("map", "<u2"),
        ("count", "<u2"),
        ("points_cm", "<i2", (MAX_BEAMS, 2)),
    ]
)
"""Where the robot was on a map [m], and the first `count` echoes seen from there [cm]."""
STATES: tuple[PoseState, ...] = get_args(PoseState)


class Capacity(NamedTuple):
    """How much is kept."""

    poses: int
    scans: int
    thins: bool
    """Whether, where there is no more room, every second sample goes instead of the oldest."""


LATELY = Capacity(1200, 600, thins=False)
"""Ten minutes: poses at 2 Hz, scans at 1 Hz."""
TRIP = Capacity(3600, 900, thins=True)
"""A trip of any length: the first half hour at 2 Hz, a longer one more coarsely."""


class Sentence(Struct, frozen=True):
    """What was said of the robot from then on."""

    at_ns: int
    tone: Tone
    text: str


class Aim(Struct, frozen=True):
    """Where it was to drive from then on, on the map that it was on; None: nowhere."""

    at_ns: int
    pose: Pose2D | None


class Failure(Struct, frozen=True):
    """A stop of a trip that was not reached; `started_at` and `stop` are those of its result."""

    at_ns: int
    stop: int
    started_at: str | None
    text: str


@dataclass(frozen=True)
class Trouble:
    """A warning or a failure that the robot reported, and when."""

    at_ns: int
    words: StatusLine


@dataclass(frozen=True)
class Then:
    """What was known at some time; None or nothing where it was not known."""

    at_ns: int
    map: str = ""
    pose: Pose2D | None = None
    state: PoseState = "localized"
    words: StatusLine | None = None
    aim: Pose2D | None = None
    scan: NDArray[np.float32] | None = None
    """(n, 2) x, y [m] on the map."""


@dataclass(frozen=True, eq=False)
class PastView:
    """What is drawn on the map for a time in the past."""

    then: Then
    track: NDArray[np.float32]
    """Pieces of the line that was driven until then, (n, 2, 2) x, y [m] on its map."""


Timed = TypeVar("Timed", Sentence, Aim, Failure)


class Record:
    """The record of one robot; what is added must not be older than what is there."""

    def __init__(self, capacity: Capacity) -> None:
        self.poses = Rows(POSE, capacity.poses, thins=capacity.thins)
        self.scans = Rows(SCAN, capacity.scans, thins=capacity.thins)
        self.maps: list[str] = []
        """The names of the maps, which poses and scans name by their index."""
        self.sentences: list[Sentence] = []
        self.aims: list[Aim] = []
        self.failures: list[Failure] = []
        self.first_ns: int | None = None
        """Since when anything is known; None for nothing at all."""
        self.last_ns = 0
        """Until when it is known."""

    @staticmethod
    def empty() -> "Record":
        """One of nothing, to which nothing is added."""
        return Record(Capacity(0, 0, thins=False))

    # What is added.
    def add_pose(
        self, at_ns: int, robot_ns: int, map_name: str, pose: Pose2D, state: PoseState
    ) -> None:
        """Add where the robot was."""
        row = (at_ns, robot_ns, pose.x, pose.y, pose.yaw, STATES.index(state), self._map(map_name))
        if self.poses.append(row):
            self._extend(at_ns)

    def add_scan(
        self, at_ns: int, map_name: str, origin: Pose2D, points: NDArray[np.floating[Any]]
    ) -> None:
        """Add what it saw.

        Args:
            at_ns: when.
            map_name: the map.
            origin: where the robot was.
            points: (n, 2) echoes [m] on the map; of more than are kept, some.
        """
        some = points[:: -(-len(points) // MAX_BEAMS) or 1]
        off_cm = np.rint((some - (origin.x, origin.y)) / CM)
        off_cm = off_cm[(np.abs(off_cm) <= np.iinfo(np.int16).max).all(axis=1)]
        kept = np.zeros((MAX_BEAMS, 2), np.int16)
        kept[: len(off_cm)] = off_cm
        self.scans.append((at_ns, origin.x, origin.y, self._map(map_name), len(off_cm), kept))

    def say(self, at_ns: int, words: StatusLine) -> None:
        """Note what is said of it, where that is new."""
        last = self.sentences[-1] if self.sentences else None
        if last is None or (last.text, last.tone) != (words.headline, words.tone):
            _add(self.sentences, Sentence(at_ns, words.tone, words.headline))
        self._extend(at_ns)

    def aim(self, at_ns: int, pose: Pose2D | None) -> None:
        """Note where it is to drive, where that is new."""
        if pose != (self.aims[-1].pose if self.aims else None):
            _add(self.aims, Aim(at_ns, pose))

    def fail(self, failure: Failure) -> None:
        """Note that a stop of a trip was not reached."""
        _add(self.failures, failure)
        self._extend(failure.at_ns)

    def drop_before(self, at_ns: int) -> None:
        """Forget what is older; what was last said and aimed for before holds on."""
        self.poses.drop_before(at_ns)
        self.scans.drop_before(at_ns)
        for texts in (self.sentences, self.aims):
            while len(texts) > 1 and texts[1].at_ns <= at_ns:
                texts.pop(0)
        while self.failures and self.failures[0].at_ns < at_ns:
            self.failures.pop(0)
        if self.first_ns is not None:
            self.first_ns = None if self.last_ns < at_ns else max(self.first_ns, at_ns)

    def go_on(self, newer: "Record") -> None:
        """Take in what was recorded since; what is here must be older, whatever clocks say."""
        if newer.first_ns is None:
            return
        if self.last_ns >= newer.first_ns:
            self.shift(newer.first_ns - 1 - self.last_ns)
        of_map = [self._map(name) for name in newer.maps]
        for mine, other in ((self.poses, newer.poses), (self.scans, newer.scans)):
            for row in other.rows.copy():
                row["map"] = of_map[int(row["map"])]
                mine.append(tuple(row))
        for one in newer.sentences:
            self.say(one.at_ns, StatusLine(one.text, one.tone))
        for one in newer.aims:
            self.aim(one.at_ns, one.pose)
        for one in newer.failures:
            self.fail(one)
        self._extend(newer.last_ns)

    def shift(self, by_ns: int) -> None:
        """Count all times from elsewhere, as those of a clock that started over."""
        for rows in (self.poses.rows, self.scans.rows):
            rows[AT] += by_ns
        self.sentences = _shifted(self.sentences, by_ns)
        self.aims = _shifted(self.aims, by_ns)
        self.failures = _shifted(self.failures, by_ns)
        self.first_ns = None if self.first_ns is None else self.first_ns + by_ns
        self.last_ns += by_ns

    # What is asked.
    def copy(self) -> "Record":
        """The same, which does not change any more."""
        copy = Record.empty()
        copy.poses, copy.scans = self.poses.copy(), self.scans.copy()
        copy.maps, copy.sentences = [*self.maps], [*self.sentences]
        copy.aims, copy.failures = [*self.aims], [*self.failures]
        copy.first_ns, copy.last_ns = self.first_ns, self.last_ns
        return copy

    def at(self, at_ns: int) -> Then:
        """What was known at a time."""
        words = self._words(at_ns)
        found = self._row(self.poses, at_ns, POSE_HOLDS_NS)
        if found is None:
            return Then(at_ns, words=words)
        pose = Pose2D(float(found["x"]), float(found["y"]), float(found["yaw"]))
        map_name = self.maps[int(found["map"])]
        aim = _newest(self.aims, at_ns)
        scan = self._scan(at_ns, int(found["map"]))
        state = STATES[min(int(found["state"]), len(STATES) - 1)]
        return Then(at_ns, map_name, pose, state, words, aim.pose if aim else None, scan)

    def track(self, at_ns: int, since_ns: int, map_name: str) -> NDArray[np.float32]:
        """Where the robot drove on a map until a time: pieces of a line (n, 2, 2) [m].

        Nothing joins two poses between which it was carried, or was not heard of.
        """
        rows = self.poses.rows
        of_map = self.maps.index(map_name) if map_name in self.maps else -1
        rows = rows[(rows[AT] <= at_ns) & (rows[AT] >= since_ns) & (rows["map"] == of_map)]
        if len(rows) < 2:
            return np.zeros((0, 2, 2), np.float32)
        points = np.stack([rows["x"], rows["y"]], axis=1)
        steps_m = np.hypot(*np.diff(points, axis=0).T)
        waits_ns = np.diff(rows[AT])
        is_break = (steps_m > MAX_STEP_M) | (waits_ns > self._holds_ns(self.poses, POSE_HOLDS_NS))
        piece = np.concatenate([[0], np.cumsum(is_break)])
        driven = np.concatenate([[0.0], np.cumsum(np.where(is_break, 0.0, steps_m))])
        step_m = max(TRACK_STEP_M, float(driven[-1]) / MAX_TRACK)
        is_kept = np.concatenate([[True], np.diff(np.floor(driven / step_m)) > 0])
        is_kept[1:] |= is_break
        is_kept[-1] = True
        points, piece = points[is_kept], piece[is_kept]
        pairs = np.stack([points[:-1], points[1:]], axis=1)
        return pairs[piece[:-1] == piece[1:]]

    def troubles(self) -> list[Trouble]:
        """What went wrong, oldest first: warnings that nobody asked for, and stops that failed."""
        said = [
            Trouble(one.at_ns, StatusLine(one.text, one.tone))
            for one in self.sentences
            if one.tone in ("warn", "bad") and not is_asked_for(one.text)
        ]
        failed = [Trouble(one.at_ns, StatusLine(one.text, "bad")) for one in self.failures]
        return sorted([*said, *failed], key=lambda one: one.at_ns)

    # Inside.
    def _extend(self, at_ns: int) -> None:
        self.first_ns = at_ns if self.first_ns is None else self.first_ns
        self.last_ns = max(self.last_ns, at_ns)

    def _map(self, name: str) -> int:
        """The index of a map; those that come after all that there is room for have no name."""
        if name not in self.maps and len(self.maps) < MAX_TEXTS:
            self.maps.append(name if len(self.maps) < MAX_TEXTS - 1 else "")
        return self.maps.index(name) if name in self.maps else MAX_TEXTS - 1

    def _words(self, at_ns: int) -> StatusLine | None:
        failure, said = _newest(self.failures, at_ns), _newest(self.sentences, at_ns)
        if said is None and self.sentences:
            first = self.sentences[0]
            said = first if first.at_ns - at_ns <= FIRST_HOLDS_NS else None
        if failure is not None and at_ns - failure.at_ns <= FAILURE_HOLDS_NS:
            return StatusLine(failure.text, "bad")
        return None if said is None else StatusLine(said.text, said.tone)

    def _scan(self, at_ns: int, of_map: int) -> NDArray[np.float32] | None:
        found = self._row(self.scans, at_ns, SCAN_HOLDS_NS)
        if found is None or int(found["map"]) != of_map:
            return None
        off_m = found["points_cm"][: int(found["count"])].astype(np.float32) * np.float32(CM)
        return off_m + np.array([found["x"], found["y"]], np.float32)

    def _row(self, of: Rows, at_ns: int, holds_ns: int) -> Any | None:
        """The newest row at a time that still holds then."""
        index = of.index(at_ns)
        if index < 0 or at_ns - int(of.rows[AT][index]) > self._holds_ns(of, holds_ns):
            return None
        return of.rows[index]

    def _holds_ns(self, of: Rows, holds_ns: int) -> int:
        return max(holds_ns, 3 * of.gap_ns)


def _add(texts: list[Timed], text: Timed) -> None:
    texts.append(text)
    del texts[:-MAX_TEXTS]


def _shifted(texts: list[Timed], by_ns: int) -> list[Timed]:
    return [structs.replace(one, at_ns=one.at_ns + by_ns) for one in texts]


def _newest(texts: Sequence[Timed], at_ns: int) -> Timed | None:
    """The newest that is not newer than a time."""
    return next((one for one in reversed(texts) if one.at_ns <= at_ns), None)
