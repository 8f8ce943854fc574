"""The part of the service that keeps poses and tours: stored keys, requests, files, health."""

from collections.abc import Callable
from typing import Any, TypeVar

from msgspec import Struct, structs

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages import PoseEstimate, SavedPose, SavedPoses, Tour, Tours
from trolley.messages.request_params import Named
from trolley.runtime.service import Later, Service, answers, gets, on, on_delete
from trolley_tour.stored import checks
from trolley_tour.stored.named_store import Shelf

T = TypeVar("T", SavedPose, Tour)
F = TypeVar("F", bound=Struct)

POSES_FILE = "poses.toml"
TOURS_FILE = "tours.toml"


class Keeping(Service):
    """Saved poses and tours."""

    def __init__(self, config: RobotConfig) -> None:
        self.config = config
        self._problems: dict[str, str] = {}
        self._locked: set[str] = set()
        self.poses: Shelf[SavedPose] = Shelf(
            lambda poses: checks.PosesFile(poses=poses),
            lambda content, then: self.save(POSES_FILE, content, then),
            self._publish_poses,
        )
        self.tours: Shelf[Tour] = Shelf(
            lambda tours: checks.ToursFile(tours=tours),
            lambda content, then: self.save(TOURS_FILE, content, then),
            self._publish_tours,
        )

    def start(self) -> None:
        """Read what is stored and say it."""
        self.pose = self.watch(topics.POSE, then=self.hear_pose)
        poses = self.read(POSES_FILE, checks.PosesFile)
        tours = self.read(TOURS_FILE, checks.ToursFile)
        self.poses.items = checks.by_name(poses.poses if poses else [])
        self.tours.items = checks.by_name(tours.tours if tours else [])
        self._publish_poses()
        self._publish_tours()

    def hear_pose(self, estimate: PoseEstimate) -> None:
        """Called with each estimate; what keeps places needs the newest only."""

    @property
    def map_name(self) -> str | None:
        """The map that the robot is on, None while unknown."""
        return None if self.pose.latest is None else self.pose.latest.map

    # Files and health.
    def set_problem(self, about: str, problem: str | None) -> None:
        """Say in `health` what is wrong with something, or that it is well again."""
        if problem is None:
            self._problems.pop(about, None)
        else:
            self._problems[about] = problem
        if self._problems:
            self.set_health("degraded", " ".join(self._problems.values()))
        else:
            self.set_health("ok")

    def read(self, name: str, kind: type[F]) -> F | None:
        """Read a file of the state folder; a broken one is reported."""
        path = self.state.path / name
        existed = path.exists()
        content = self.state.read(name, kind)
        if content is None and existed:
            if path.exists():  # it cannot even be read, so it must not be overwritten
                self._locked.add(name)
                self.set_problem(name, f"{name} cannot be read; nothing new is saved in it.")
            else:
                self.set_problem(f"{name} before", f"{name} was broken and has been kept aside.")
        return content

    def save(self, name: str, content: Struct, then: Callable[[str | None], None]) -> None:
        """Save a file, then call back with what kept it from being saved."""
        if name in self._locked:
            then(self._problems[name])
            return
        state = self.state

        def write() -> str | None:
            try:
                state.write(name, content)
            except OSError as error:
                return f"{name} could not be saved: {error.strerror}."
            return None

        def written(problem: str | None) -> None:
            if problem is not None:
                self.count(f"{name}/not_saved")
                self.log.error("A file could not be saved", file=name, why=problem)
            self.set_problem(name, problem)
            then(problem)

        self.work(write, written)

    # Poses.
    def put_pose(
        self, pose: SavedPose, key: str | None, answer: Callable[[SavedPose | Refused], None]
    ) -> None:
        """Check a pose and save it; a refusal that is known at once is raised."""
        checked = checks.checked_pose(pose, key, self.map_name)
        if checked.saved_at is None:
            checked = structs.replace(checked, saved_at=self.utc_now())
        self.poses.change(lambda items: (checks.with_item(items, checked), checked), answer)

    @on(topics.SAVED_POSE)
    def _wish_pose(self, pose: SavedPose, name: str) -> None:
        self.put_pose(pose, name, lambda result: self._note_wish("poses", name, result))

    @on_delete(topics.SAVED_POSE)
    def _wish_no_pose(self, *chunks: str) -> None:
        self._wish_none(self.poses, "poses", chunks)

    @answers(requests.POSES_PUT)
    def _ask_put_pose(self, pose: SavedPose) -> Later[SavedPose]:
        later = self.later()
        self.put_pose(pose, None, _settling(later))
        return later

    @answers(requests.POSES_DELETE)
    def _ask_delete_pose(self, params: Named) -> Later[SavedPose]:
        later = self.later()
        self.poses.change(lambda items: checks.without_item(items, params.name), _settling(later))
        return later

    @gets(topics.SAVED_POSE)
    def _get_poses(self, parameters: dict[str, str]) -> dict[tuple[str, ...], SavedPose]:
        del parameters
        return {(name,): pose for name, pose in self.poses.items.items()}

    def _publish_poses(self) -> None:
        poses = list(self.poses.items.values())
        self.publish(topics.POSES, SavedPoses(stamp_ns=self.stamp_ns, poses=poses))

    # Tours.
    @on(topics.STORED_TOUR)
    def _wish_tour(self, tour: Tour, name: str) -> None:
        checked = checks.checked_tour(tour, name)
        self.tours.change(
            lambda items: (checks.with_item(items, checked), checked),
            lambda result: self._note_wish("tours", name, result),
        )

    @on_delete(topics.STORED_TOUR)
    def _wish_no_tour(self, *chunks: str) -> None:
        self._wish_none(self.tours, "tours", chunks)

    @answers(requests.TOURS_PUT)
    def _ask_put_tour(self, tour: Tour) -> Later[Tour]:
        checked = checks.checked_tour(tour, tour.name)
        later = self.later()
        self.tours.change(
            lambda items: (checks.with_item(items, checked), checked), _settling(later)
        )
        return later

    @answers(requests.TOURS_DELETE)
    def _ask_delete_tour(self, params: Named) -> Later[Tour]:
        later = self.later()
        self.tours.change(lambda items: checks.without_item(items, params.name), _settling(later))
        return later

    @gets(topics.STORED_TOUR)
    def _get_tours(self, parameters: dict[str, str]) -> dict[tuple[str, ...], Tour]:
        del parameters
        return {(name,): tour for name, tour in self.tours.items.items()}

    def _publish_tours(self) -> None:
        tours = list(self.tours.items.values())
        self.publish(topics.TOURS, Tours(stamp_ns=self.stamp_ns, tours=tours))

    # Wishes.
    def _wish_none(self, shelf: Shelf[T], what: str, chunks: tuple[str, ...]) -> None:
        if len(chunks) != 1:
            raise Refused(codes.BAD_REQUEST, "A deletion names one thing.")
        shelf.change(
            lambda items: checks.without_item(items, chunks[0]),
            lambda result: self._note_wish(what, chunks[0], result),
        )

    def _note_wish(self, what: str, name: str, result: object) -> None:
        if isinstance(result, Refused):
            self.count(f"{what}/{result.code}")
            self.log.limited(f"{what}/{result.code}", "Refused", name=name, why=result.message)


def _settling(later: Later[Any]) -> Callable[[Any], None]:
    """Answer a request with a value or a refusal."""
    return lambda result: (
        later.refuse(result) if isinstance(result, Refused) else later.reply(result)
    )
