"""The part of the service that answers where the robot is, and saves it under a name."""

import dataclasses
from collections.abc import Mapping

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import CapturedPose, Odometry, PoseEstimate, SavedPose
from trolley.messages.request_params import Capture
from trolley.runtime.service import Later, Watch, answers, every
from trolley_tour.stored import checks
from trolley_tour.stored.places import Keeping
from trolley_tour.stored.pose_estimates import (
    Averaging,
    age_s,
    check_standing,
    checked_estimate,
)

DEADLINE_NS = 1_300_000_000
"""Local time for collecting estimates: the answer, saved, is due within 2 s."""
MAX_CAPTURES = 16


@dataclasses.dataclass
class _Running:
    """A capture that collects estimates."""

    params: Capture
    name: str
    later: Later[CapturedPose]
    ends_ns: int
    averaging: Averaging = dataclasses.field(default_factory=Averaging)
    is_standing: bool = False


class Capturing(Keeping):
    """`pose/capture`."""

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self._running: list[_Running] = []
        self._odometry: Watch[Odometry] | None = None

    @answers(requests.POSE_CAPTURE)
    def _capture(self, params: Capture) -> CapturedPose | Later[CapturedPose]:
        estimate = checked_estimate(self.pose.latest, self.now_ns)
        if params.name is None:
            place = SavedPose(
                map=estimate.map or "",
                pose=estimate.pose or Pose2D.identity(),
                covariance=estimate.covariance,
                icon=params.icon,
            )
            return self._captured(place, estimate)
        name = checks.plain_name(params.name)
        if name in self.poses.items and not params.replace:
            raise Refused(codes.EXISTS, name=name)
        _check_sure(estimate)
        if len(self._running) >= MAX_CAPTURES:
            raise Refused(codes.NOT_READY, "Other poses are being saved: try again.")
        later: Later[CapturedPose] = self.later()
        self._running.append(_Running(params, name, later, self.monotonic_ns + DEADLINE_NS))
        # Odometry comes 50 times a second and is of no interest otherwise.
        if self._odometry is None:
            self._odometry = self.watch(topics.ODOM, then=self._hear_odometry)
        return later

    def _hear_odometry(self, odometry: Odometry) -> None:
        for running in list(self._running):
            try:
                check_standing(odometry.twist)
                running.is_standing = True
            except Refused as refused:
                self._refuse(running, refused)

    def hear_pose(self, estimate: PoseEstimate) -> None:
        """Take an estimate for the captures that collect some."""
        for running in list(self._running):
            try:
                checked = checked_estimate(estimate, self.now_ns)
                _check_sure(checked)
                if running.averaging.add(checked) and running.is_standing:
                    self._finish(running)
            except Refused as refused:
                self._refuse(running, refused)

    @every(0.1, clock="local")
    def _end_captures(self) -> None:
        for running in list(self._running):
            if self.monotonic_ns >= running.ends_ns:
                try:
                    self._finish(running)
                except Refused as refused:
                    self._refuse(running, refused)

    def _finish(self, running: _Running) -> None:
        if not running.is_standing:
            raise Refused(codes.STALE, "There is no odometry: base is not running.")
        estimate, pose, covariance = running.averaging.mean()
        place = checks.checked_pose(
            SavedPose(
                name=running.name,
                map=estimate.map or "",
                pose=pose,
                covariance=covariance,
                saved_at=self.utc_now(),
                icon=running.params.icon,
            ),
            None,
            self.map_name,
        )
        self._end(running)

        def change(items: Mapping[str, SavedPose]) -> tuple[dict[str, SavedPose], SavedPose]:
            before = items.get(place.name)
            if before is not None and not running.params.replace:
                raise Refused(codes.EXISTS, name=place.name)
            return checks.with_item(items, place), place

        def answer(result: SavedPose | Refused) -> None:
            if isinstance(result, Refused):
                running.later.refuse(result)
            else:
                self.log.info("Pose saved", name=result.name, map=result.map)
                running.later.reply(self._captured(result, estimate))

        self.poses.change(change, answer)

    def _refuse(self, running: _Running, refused: Refused) -> None:
        self._end(running)
        running.later.refuse(refused)

    def _end(self, running: _Running) -> None:
        if running in self._running:
            self._running.remove(running)
        if not self._running and self._odometry is not None:
            self.close_watch(self._odometry)
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
            age=age_s(estimate, self.now_ns) or 0.0,
        )


def _check_sure(estimate: PoseEstimate) -> None:
    """Refuse to save where the scan does not fit the map: what is certain may still be wrong."""
    if estimate.state == "unsure":
        raise Refused(
            codes.NOT_CONVERGED,
            "The scan does not fit the map well; drive a little or set the pose.",
        )
