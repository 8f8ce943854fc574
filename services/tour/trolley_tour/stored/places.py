"""Saved poses: stored keys, requests, `poses.toml`, and the stream `poses`."""

from collections.abc import Mapping

from msgspec import structs

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import SavedPose, SavedPoses
from trolley.messages.request_params import Named
from trolley.runtime.service import Later, Service, answers, gets, on, on_delete
from trolley_tour.robot_state import RobotState
from trolley_tour.state_files import StateFiles
from trolley_tour.stored import checks
from trolley_tour.stored.named_store import Answer, NamedStore, WishLog, answer_later

POSES_FILE = "poses.toml"


class Places:
    """The saved poses by name."""

    def __init__(self, service: Service, files: StateFiles, robot: RobotState) -> None:
        self._service = service
        self._files = files
        self._robot = robot
        self._wishes = WishLog(service, "poses")
        self._store: NamedStore[SavedPose] = NamedStore(
            "saved place",
            lambda poses: checks.PosesFile(poses=poses),
            lambda content, then: files.save(POSES_FILE, content, then),
            self._publish,
        )

    def start(self) -> None:
        """Read what is stored and publish it."""
        file = self._files.read(POSES_FILE, checks.PosesFile)
        self._store.items, doubled = checks.by_name(file.poses if file else [])
        self._files.say_doubled(POSES_FILE, doubled)
        self._publish()

    @property
    def items(self) -> Mapping[str, SavedPose]:
        """What is stored, by name."""
        return self._store.items

    def find(self, name: str) -> Pose2D:
        """Where a saved pose is on the present map; raises `Refused`."""
        return checks.find_place(self._store.items, name, self._robot.map_name)

    def put(
        self,
        pose: SavedPose,
        answer: Answer[SavedPose],
        *,
        key: str | None = None,
        replace: bool = True,
    ) -> None:
        """Check a pose and save it; `answer` gets it once it is saved, or a refusal.

        Raises:
            Refused: What is known at once to be wrong with it.
        """
        checked = checks.checked_pose(pose, key, self._robot.map_name)
        if checked.saved_at is None:
            checked = structs.replace(checked, saved_at=self._service.utc_now())

        def change(items: Mapping[str, SavedPose]) -> tuple[dict[str, SavedPose], SavedPose]:
            if checked.name in items and not replace:
                raise Refused(codes.EXISTS, name=checked.name)
            return checks.with_item(items, checked), checked

        self._store.change(change, answer)

    @on(topics.SAVED_POSE)
    def _put_by_key(self, pose: SavedPose, name: str) -> None:
        self.put(pose, self._wishes.note_result_of(name), key=name)

    @on_delete(topics.SAVED_POSE)
    def _delete_by_key(self, *chunks: str) -> None:
        self._store.delete(checks.only_chunk(chunks), self._wishes.note_result_of(chunks[0]))

    @answers(requests.POSES_PUT)
    def _put_on_request(self, pose: SavedPose) -> Later[SavedPose]:
        later: Later[SavedPose] = self._service.later()
        self.put(pose, answer_later(later))
        return later

    @answers(requests.POSES_DELETE)
    def _delete_on_request(self, params: Named) -> Later[SavedPose]:
        later: Later[SavedPose] = self._service.later()
        self._store.delete(params.name, answer_later(later))
        return later

    @gets(topics.SAVED_POSE)
    def _get(self, parameters: dict[str, str]) -> dict[tuple[str, ...], SavedPose]:
        del parameters
        return {(name,): pose for name, pose in self._store.items.items()}

    def _publish(self) -> None:
        poses = list(self._store.items.values())
        self._service.publish(
            topics.POSES, SavedPoses(stamp_ns=self._service.stamp_ns, poses=poses)
        )
