"""The request `pose/capture`: where the robot is, saved under a name if one is given."""

import dataclasses

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import CapturedPose, Odometry, PoseEstimate, SavedPose
from trolley.messages.request_params import Capture
from trolley.runtime.service import Later, Service, Watch, answers, every
from trolley_tour.robot_state import RobotState
from trolley_tour.stored.checks import plain_name
from trolley_tour.stored.places import Places
from trolley_tour.stored.pose_estimates import (
    PoseAverage,
    age_s,
    check_standing,
    check_sure,
    checked_estimate,
)

DEADLINE_NS = 1_300_000_000
"""Local time for collecting estimates: the answer, saved, is due within 2 s."""
MAX_CAPTURES = 16
"""Captures that collect at the same time; more are refused."""


@dataclasses.dataclass
class _Collection:
    """A capture that is collecting estimates."""

    name: str
    params: Capture
    later: Later[CapturedPose]
    ends_ns: int
    average: PoseAverage = dataclasses.field(default_factory=PoseAverage)
    is_standing: bool = False


class PoseCapture:
    """Answers `pose/capture`: averages estimates of a standing robot, and saves the place."""

    def __init__(self, service: Service, places: Places, robot: RobotState) -> None:
        self._service = service
        self._places = places
        self._robot = robot
        self._collections: list[_Collection] = []
        self._odometry: Watch[Odometry] | None = None

    @answers(requests.POSE_CAPTURE)
    def _capture(self, params: Capture) -> CapturedPose | Later[CapturedPose]:
        estimate = checked_estimate(self._robot.pose.latest, self._service.now_ns)
        if params.name is None:
            place = SavedPose(
                map=estimate.map or "",
                pose=estimate.pose or Pose2D.identity(),
                covariance=estimate.covariance,
                icon=params.icon,
            )
            return self._captured(place, estimate)
        name = plain_name(params.name)
        if name in self._places.items and not params.replace:
            raise Refused(codes.EXISTS, name=name)
        check_sure(estimate)
        if len(self._collections) >= MAX_CAPTURES:
            raise Refused(codes.NOT_READY, "Other poses are being saved; try again.")
        later: Later[CapturedPose] = self._service.later()
        ends_ns = self._service.monotonic_ns + DEADLINE_NS
        self._collections.append(_Collection(name, params, later, ends_ns))
        # Odometry comes 50 times a second and is of no interest otherwise.
        if self._odometry is None:
            self._odometry = self._service.watch(topics.ODOM, then=self._update_odometry)
        return later

    def _update_odometry(self, odometry: Odometry) -> None:
        for collection in list(self._collections):
            try:
                check_standing(odometry.twist)
                collection.is_standing = True
            except Refused as refused:
                self._refuse(collection, refused)

    def update_pose(self, estimate: PoseEstimate) -> None:
        """Add an estimate to the captures that are collecting."""
        for collection in list(self._collections):
            try:
                checked = checked_estimate(estimate, self._service.now_ns)
                check_sure(checked)
                if collection.average.add(checked) and collection.is_standing:
                    self._save(collection)
            except Refused as refused:
                self._refuse(collection, refused)

    @every(0.1, clock="local")
    def _end_overdue(self) -> None:
        for collection in list(self._collections):
            if self._service.monotonic_ns >= collection.ends_ns:
                try:
                    self._save(collection)
                except Refused as refused:
                    self._refuse(collection, refused)

    def _save(self, collection: _Collection) -> None:
        if not collection.is_standing:
            raise Refused(codes.STALE, "There is no odometry; the base is not running.")
        estimate, pose, covariance = collection.average.mean()
        self._remove(collection)

        def answer(result: SavedPose | Refused) -> None:
            if isinstance(result, Refused):
                collection.later.refuse(result)
            else:
                self._service.log.info("Pose saved", name=result.name, map=result.map)
                collection.later.reply(self._captured(result, estimate))

        place = SavedPose(
            name=collection.name,
            map=estimate.map or "",
            pose=pose,
            covariance=covariance,
            icon=collection.params.icon,
        )
        self._places.put(place, answer, replace=collection.params.replace)

    def _refuse(self, collection: _Collection, refused: Refused) -> None:
        self._remove(collection)
        collection.later.refuse(refused)

    def _remove(self, collection: _Collection) -> None:
        if collection in self._collections:
            self._collections.remove(collection)
        if not self._collections and self._odometry is not None:
            self._service.close_watch(self._odometry)
            self._odometry = None

    def _captured(self, place: SavedPose, estimate: PoseEstimate) -> CapturedPose:
        return CapturedPose(
            name=place.name,
            map=place.map,
            pose=place.pose,
            covariance=place.covariance,
            saved_at=place.saved_at,
            icon=place.icon,
            note=place.note,
            state=estimate.state,
            match=estimate.match,
            age=age_s(estimate, self._service.now_ns) or 0.0,
        )
