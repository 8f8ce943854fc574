"""Switching the robot to a map that was changed: the map first, then what lies on it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.files import make_folder, write_atomically
from trolley.geometry import Pose2D
from trolley.messages import PoseEstimate, SavedPose, Tour, Zone, Zones
from trolley.messages.request_params import LoadMap, Named, WhichGoal
from trolley.runtime.service import Service
from trolley.state_file import Unreadable, keep_unreadable, read_encoded, reason_of
from trolley_mapper.edit.map_versions import MapVersions

PLAN_FILE = "map_edit.json"
"""The plan's name in the robot's state folder, until it is carried out."""
LOAD_NS = 60_000_000_000
"""Local time after which a map counts as not loaded [ns]."""
MAX_TRIES = 5
"""Number of requests without an answer after which a service counts as absent."""
KNOWN = ("localized", "unsure")
"""States of a pose that the new map's localization can start from."""
STANDS_IN_OBSTACLE = (
    "The robot stands in an obstacle of this map, or outside it, and now searches for its position."
)
FOLLOWS = "The robot stays on the map of before; restart the mapper to try again."
CAN_UNDO = "Or undo the edit."
OTHER_MAP = "The robot is on another map by now."
NO_ROOM = (codes.IN_OBSTACLE, codes.OUTSIDE_MAP)
"""Refusals of a pose, not of the map."""
MAY_PASS = (*codes.UNANSWERED, codes.NOT_SAVED)
"""Refusals that may have passed by the next start of the mapper."""


class SwitchPlan(Struct, frozen=True, kw_only=True):
    """What the robot's services are to be told after an edit; stored until they know.

    Zones, places and tours are given as they are to be, so that telling twice does no harm.
    """

    schema: int = 3
    """Version of the file's format. Files of the first version have none."""
    map: str
    """The map to be loaded."""
    of: str
    """The map that the robot was on."""
    version: int | None
    """Version of the map from which the plan holds; None for any."""
    old_T_new: Pose2D
    """Maps points of the new map to the old one."""
    zones: list[Zone] = []
    """Zones to store."""
    zones_gone: list[str] = []
    """Names of the zones to delete."""
    places: list[SavedPose] = []
    """Places to store."""
    tours: list[Tour] = []
    """Tours to store."""

    @property
    def is_to_other(self) -> bool:
        """Whether the robot goes to another map; the one that it was on stays as it is."""
        return self.of != self.map


def store_plan(state: Path, plan: SwitchPlan) -> None:
    """Write a plan down before the map is stored, so that it is carried out in any case.

    Raises:
        OSError: it cannot be written.
    """
    make_folder(state)
    write_atomically(state / PLAN_FILE, msgspec.json.encode(plan))


def pending_plan(state: Path, versions: MapVersions) -> SwitchPlan | str | None:
    """Return the plan that the last run did not carry out, None if there is none.

    A plan that cannot be read is set aside; a sentence says so. So it does of a void one that
    cannot be deleted.
    """
    file = state / PLAN_FILE
    try:
        plan = read_encoded(file, SwitchPlan, msgspec.json.decode)
    except FileNotFoundError:
        return None
    except (Unreadable, OSError) as error:
        return _put_aside(file, error)
    now = versions.newest(plan.map)
    is_stored = plan.version is None or (now is not None and now.number == plan.version)
    if not is_stored:  # the power failed before the map was
        return forget_plan(state)
    return plan


def _put_aside(file: Path, why: Exception) -> str:
    words = f"The pending switch to an edited map cannot be read ({reason_of(why)})"
    try:
        aside = keep_unreadable(file, why)
    except OSError as error:
        return f"{words}, nor be kept aside: {error.strerror}."
    return (
        f"{words}; it is kept as {aside.name}. Places and zones may still be where they were "
        "before."
    )


def forget_plan(state: Path) -> str | None:
    """Delete the plan: it is carried out or void; returns why that failed, in a sentence."""
    try:
        (state / PLAN_FILE).unlink(missing_ok=True)
    except OSError as error:
        return f"{PLAN_FILE}, which is no longer needed, cannot be deleted: {error.strerror}."
    return None


def _shorten_plan(state: Path, plan: SwitchPlan, left: list[Any]) -> str | None:
    """Leave in the plan only what the next run is to try again; says why that failed.

    The rest would undo what people have changed by then.
    """
    shorter = msgspec.structs.replace(
        plan,
        zones=[zone for zone in plan.zones if zone in left],
        zones_gone=[name for name in plan.zones_gone if Named(name=name) in left],
        places=[place for place in plan.places if place in left],
        tours=[tour for tour in plan.tours if tour in left],
    )
    try:
        store_plan(state, shorter)
    except OSError as error:
        return f"{PLAN_FILE} cannot be written: {error.strerror}."
    return None


class MapSwitch:
    """Tells localizer and tour of a changed map, one request after the other.

    On a small computer the localizer reads a map for longer than it may take to answer. Zones that
    came before it has would be those of the map before.

    Args:
        plan: what they are to be told.
        done: called at the end, with what people have to know of it, in a sentence, or nothing.
    """

    def __init__(self, service: Service, plan: SwitchPlan, done: Callable[[str], None]) -> None:
        self._service, self._plan, self._done = service, plan, done
        self._is_given_up = False
        self._remark = ""
        self._problems: list[str] = []
        self._left: list[Any] = []
        self._todo: list[tuple[requests.Request[Any, Any], Any]] = []
        self._num_tries = 0
        self._zones_before: Zones | None = None
        self._waits_until_ns: int | None = None

    def begin(self, estimate: PoseEstimate | None = None) -> None:
        """Begin: with where the robot is now, or unknown to us after a restart."""
        plan = self._plan
        pose = None
        moves = plan.is_to_other or plan.old_T_new != Pose2D.identity()
        if moves and estimate is not None and estimate.pose and estimate.state in KNOWN:
            pose = plan.old_T_new.inverse() @ estimate.pose
        self._todo += [(requests.ZONES_DELETE, Named(name=name)) for name in plan.zones_gone]
        self._todo += [(requests.ZONES_PUT, zone) for zone in plan.zones]
        self._todo += [(requests.POSES_PUT, place) for place in plan.places]
        self._todo += [(requests.TOURS_PUT, tour) for tour in plan.tours]
        self._service.get(topics.ZONES, then=partial(self._load, pose))

    def untold(self, zones: Zones | None) -> SwitchPlan | None:
        """Return the plan if the map was not loaded, nor, by the zones of now, anything since.

        Where the map is another than the robot is on, its zones may have changed meanwhile.
        """
        if not self._is_given_up or zones is None:
            return None
        is_still_there = self._plan.is_to_other and zones.map == self._plan.of
        return self._plan if is_still_there or zones == self._zones_before else None

    def check_loaded(self) -> None:
        """See whether a map that was long in loading is there; to be called now and then."""
        if self._waits_until_ns is not None:
            self._service.get(topics.ZONES, then=self._hear_zones)

    # The map.

    def _load(self, pose: Pose2D | None, found: dict[tuple[str, ...], Zones]) -> None:
        self._zones_before = found.get(())
        if self._zones_before is None or self._zones_before.map in (self._plan.of, self._plan.map):
            self._ask_to_load(pose)
            return
        self._service.log.warning(
            "Zones, places and tours of an edited map follow once the mapper starts on that map",
            map=self._plan.map,
        )
        self._done(OTHER_MAP)

    def _ask_to_load(self, pose: Pose2D | None) -> None:
        if self._plan.old_T_new != Pose2D.identity():
            # A goal under way is a pose on the map as it lay. A refusal means there is none.
            self._service.request(requests.GOAL_CANCEL, WhichGoal(), lambda _: None)
        params = LoadMap(name=self._plan.map, pose=pose)
        self._service.request(requests.MAP_LOAD, params, partial(self._loaded, pose))

    def _loaded(self, pose: Pose2D | None, result: object) -> None:
        if not isinstance(result, Refused):
            self._next()
        elif result.code == codes.TIMEOUT:
            self._waits_until_ns = self._service.monotonic_ns + LOAD_NS
        elif result.code in NO_ROOM and pose is not None:
            self._remark = STANDS_IN_OBSTACLE
            self._ask_to_load(None)
        else:
            can_undo = "" if self._plan.is_to_other else f" {CAN_UNDO}"
            self._give_up(result.message, f"{FOLLOWS}{can_undo}")

    def _give_up(self, why: str, what_next: str = FOLLOWS) -> None:
        """Leave all as it is: zones would move on the map of before, which the robot is still on.

        The plan stays, so that the next run carries it out.
        """
        self._service.log.error("An edited map was not loaded", map=self._plan.map, why=why)
        self._is_given_up = True
        self._done(f"{why} {what_next}")

    def _hear_zones(self, found: dict[tuple[str, ...], Zones]) -> None:
        """A localizer that has loaded the map publishes its zones."""
        if self._waits_until_ns is None:
            return
        zones = found.get(())
        if zones is not None and zones.map == self._plan.map and zones != self._zones_before:
            self._waits_until_ns = None
            self._next()
        elif self._service.monotonic_ns > self._waits_until_ns:
            self._waits_until_ns = None
            self._give_up(f"The localizer has not loaded {self._plan.map}.")

    # What lies on it.

    def _next(self) -> None:
        if self._todo:
            request, params = self._todo[0]
            self._service.request(request, params, self._answered)
            return
        state = self._service.state.path
        if self._left:
            settle = partial(_shorten_plan, state, self._plan, self._left)
        else:
            settle = partial(forget_plan, state)
        self._service.work(settle, self._settled)
        for problem in self._problems:
            self._service.log.error("A change of the map did not go through", why=problem)
        self._done(self._problems[0] if self._problems else self._remark)

    def _settled(self, problem: str | None) -> None:
        if problem is not None:
            self._service.log.error(problem)

    def _answered(self, result: object) -> None:
        self._num_tries += 1
        is_refused = isinstance(result, Refused)
        if is_refused and result.code in codes.UNANSWERED and self._num_tries < MAX_TRIES:
            self._next()
            return
        if is_refused and result.code != codes.UNKNOWN_NAME:
            self._problems.append(result.message)
        _, params = self._todo.pop(0)
        if is_refused and result.code in MAY_PASS:
            self._left.append(params)
        self._num_tries = 0
        self._next()
