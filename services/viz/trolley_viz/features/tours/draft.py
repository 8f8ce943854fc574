"""A tour as somebody edits it: points in order, checked before it is saved. No I/O."""

import math
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from trolley.geometry import Pose2D
from trolley.messages import ScheduleEntry, Stop, Tour
from trolley.messages.touring import Day
from trolley.names import canonical, name_problem

OnFailure = Literal["retry", "skip", "abort"]
Find = Callable[[str], Pose2D | None]
"""Where the place of a name is, None where there is none."""

DAYS: tuple[Day, ...] = get_args(Day)
MAX_STOPS = 1000
MAX_PASSED = 1000
MAX_SECONDS = 86_400.0
MAX_COUNT = 1000
TIME = re.compile(r"([01]?[0-9]|2[0-3])[:.]([0-5][0-9])")


@dataclass(frozen=True)
class Point:
    """A point of a tour: a place by its `name`, or a `pose` on the map; exactly one of the two.

    Where the robot only passes by (`passes`) the rest counts for nothing.
    """

    name: str | None = None
    pose: Pose2D | None = None
    passes: bool = False
    dwell: float = 0.0
    """Stay [s]."""
    timeout: float | None = None
    """Longest drive [s], None: as usual."""
    retries: int = 0
    on_failure: OnFailure = "abort"

    def where(self, find: Find) -> Pose2D | None:
        """Its pose on the map, None while its place is unknown."""
        return self.pose if self.name is None else find(self.name)


@dataclass(frozen=True)
class Draft:
    """A tour being edited; every edit gives a new draft."""

    name: str = ""
    points: tuple[Point, ...] = ()
    repeat: int = 1
    """Rounds, 0 = forever."""
    there_and_back: bool = False
    resume: bool = False
    times: tuple[ScheduleEntry, ...] = field(default=())
    map: str = ""
    """Where its spots lie, "" for the robot's map."""

    @classmethod
    def of(cls, tour: Tour) -> "Draft":
        """Open a tour."""
        points: list[Point] = []
        for stop in tour.stops:
            points += [Point(pose=pose, passes=True) for pose in stop.via]
            points.append(
                Point(
                    name=stop.name,
                    pose=stop.pose,
                    dwell=stop.dwell,
                    timeout=stop.timeout,
                    retries=stop.retries,
                    on_failure=stop.on_failure,
                )
            )
        return cls(
            name=tour.name,
            points=tuple(points),
            repeat=tour.repeat,
            there_and_back=tour.there_and_back,
            resume=tour.resume,
            times=tuple(tour.schedule),
            map=tour.map,
        )

    def tour(self, find: Find) -> Tour:
        """The tour that it makes; only one without `problems` has all of its points."""
        stops: list[Stop] = []
        via: list[Pose2D] = []
        for point in self.points:
            if point.passes:
                where = point.where(find)
                via += [] if where is None else [where]
                continue
            stops.append(
                Stop(
                    name=point.name,
                    pose=point.pose,
                    via=via,
                    dwell=point.dwell,
                    timeout=point.timeout,
                    retries=point.retries,
                    on_failure=point.on_failure,
                )
            )
            via = []
        return Tour(
            name=canonical(self.name.strip()),
            stops=stops,
            repeat=self.repeat,
            there_and_back=self.there_and_back,
            resume=self.resume,
            schedule=list(self.times),
            map=self.map,
        )

    # Edits of the points.
    def with_point(self, point: Point) -> "Draft":
        """Add a point at the end."""
        return replace(self, points=(*self.points, point))

    def without_point(self, index: int) -> "Draft":
        """Leave a point out."""
        return replace(self, points=self.points[:index] + self.points[index + 1 :])

    def moved(self, index: int, by: int) -> "Draft":
        """Put a point earlier or later, as far as there is room."""
        points = list(self.points)
        points.insert(min(max(index + by, 0), len(points) - 1), points.pop(index))
        return replace(self, points=tuple(points))

    def with_changed(self, index: int, point: Point) -> "Draft":
        """Put another point in place of one."""
        return replace(self, points=(*self.points[:index], point, *self.points[index + 1 :]))

    def stop_number(self, index: int) -> int | None:
        """Which stop a point is, counted from 1; None where the robot only passes."""
        if self.points[index].passes:
            return None
        return sum(not point.passes for point in self.points[: index + 1])

    # Checks.
    def problems(self, taken: Collection[str], find: Find) -> list[str]:
        """List in everyday words what keeps it from being saved.

        Args:
            taken: the names of other tours.
            find: knows all places, those of other maps too.
        """
        return [*self._name_problems(taken), *self._point_problems(find)]

    def _name_problems(self, taken: Collection[str]) -> list[str]:
        name = canonical(self.name.strip())
        if not name:
            return ["Give the tour a name."]
        problem = name_problem(name)
        if problem is not None:
            return [f"Choose another name: {problem}."]
        return [f"There is already a tour called “{name}”."] if name in taken else []

    def _point_problems(self, find: Find) -> list[str]:
        problems: list[str] = []
        if not self.points:
            problems.append("Add at least one place.")
        elif all(point.passes for point in self.points):
            problems.append("The robot would not stop anywhere. Let it stop somewhere.")
        elif self.points[-1].passes:
            problems.append("The robot would not stop at the last point. Let it stop there.")
        names = dict.fromkeys(point.name for point in self.points if point.where(find) is None)
        problems += [f"The place “{name}” no longer exists." for name in names]
        if sum(not point.passes for point in self.points) > MAX_STOPS:
            problems.append(f"A tour has at most {MAX_STOPS} stops.")
        if sum(point.passes for point in self.points) > MAX_PASSED:
            problems.append(f"The robot can pass by at most {MAX_PASSED} points.")
        return problems


def bearing(x: float, y: float, yaw: float | None, before: Pose2D | None) -> Pose2D:
    """A pose at a place; without a heading of its own it faces on from the previous point."""
    if yaw is None:
        yaw = 0.0 if before is None else math.atan2(y - before.y, x - before.x)
    return Pose2D(x, y, yaw)


def time_entry(text: str, days: Collection[Day]) -> ScheduleEntry | None:
    """Parse a time of day such as "8:30" on some days (all or none: every day); None if invalid."""
    found = TIME.fullmatch(text.strip())
    if found is None:
        return None
    hour, minute = found.groups()
    chosen: list[Day] = [day for day in DAYS if day in days]
    if len(chosen) == len(DAYS):
        chosen.clear()
    return ScheduleEntry(days=chosen, at=f"{hour:0>2}:{minute}")


def stay_text(stay: float) -> str:
    """Write how long the robot stays [s] for people."""
    return f"{stay:.3g} s" if stay < 120.0 else f"{stay / 60.0:.3g} min"


def days_text(days: Sequence[Day]) -> str:
    """Write days for people: "every day", "Mon-Fri", "Sat, Sun"."""
    chosen = [day in days for day in DAYS]
    if not days or all(chosen):
        return "every day"
    runs: list[str] = []
    first: int | None = None
    for i, is_chosen in enumerate([*chosen, False]):
        if is_chosen and first is None:
            first = i
        elif not is_chosen and first is not None:
            names = [day.title() for day in DAYS[first:i]]
            runs += names if len(names) < 3 else [f"{names[0]}–{names[-1]}"]
            first = None
    return ", ".join(runs)


@dataclass
class Editing:
    """An open editor: the draft, the chosen point, and what the tour was when it was opened."""

    opened: Tour | None
    """The stored tour that is edited, None for a new one."""
    draft: Draft
    chosen: int | None = None
    """The point whose details are open."""
    theirs: Tour | None = None
    """The stored tour as it is now."""

    @classmethod
    def open(cls, tour: Tour) -> "Editing":
        """Edit a stored tour."""
        return cls(tour, Draft.of(tour), theirs=tour)

    @property
    def point(self) -> Point | None:
        """The chosen point."""
        return None if self.chosen is None else self.draft.points[self.chosen]

    @property
    def was_changed(self) -> bool:
        """Whether somebody else saved or deleted this tour since it was opened."""
        return self.opened is not None and self.theirs != self.opened

    def hear(self, tours: Sequence[Tour]) -> None:
        """Take in the stored tours."""
        if self.opened is not None:
            name = self.opened.name
            self.theirs = next((one for one in tours if one.name == name), None)

    def taken(self, tours: Sequence[Tour]) -> set[str]:
        """The names that another tour has."""
        own = None if self.opened is None else self.opened.name
        return {tour.name for tour in tours} - {own}

    def keep_mine(self) -> None:
        """Keep this draft, whatever somebody else did."""
        self.opened = self.theirs

    def take_theirs(self) -> None:
        """Begin again with what somebody else saved."""
        if self.theirs is not None:
            self.opened, self.draft, self.chosen = self.theirs, Draft.of(self.theirs), None

    def add(self, point: Point) -> None:
        """Add a point at the end, and choose it."""
        self.draft = self.draft.with_point(point)
        self.chosen = len(self.draft.points) - 1

    def move(self, index: int, by: int) -> None:
        """Put a point earlier or later; the chosen one stays chosen."""
        order = list(range(len(self.draft.points)))
        order.insert(min(max(index + by, 0), len(order) - 1), order.pop(index))
        self.draft = self.draft.moved(index, by)
        if self.chosen is not None:
            self.chosen = order.index(self.chosen)

    def remove(self) -> None:
        """Leave the chosen point out."""
        if self.chosen is not None:
            self.draft = self.draft.without_point(self.chosen)
            self.chosen = None

    def change(self, point: Point) -> None:
        """Put another point in place of the chosen one."""
        if self.chosen is not None:
            self.draft = self.draft.with_changed(self.chosen, point)
