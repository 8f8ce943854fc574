"""Poses that are tied to keyframes, even to those that are removed later."""

import numpy as np

from trolley.geometry import Pose2D
from trolley_mapper.slam.estimate import Anchor
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.pose_graph import between

OWN_WITHIN_M = 3.0
"""Distance from all keyframes beyond which places of an earlier map do not move [m]."""


class Anchors:
    """Which keyframes poses are tied to, and what stands in for those that are gone."""

    def __init__(self) -> None:
        self.used: set[int] = set()
        self.successors: dict[int, Anchor] = {}

    def copy(self) -> "Anchors":
        """Return what can be read while this changes."""
        other = Anchors()
        other.used, other.successors = set(self.used), dict(self.successors)
        return other

    def tie(self, store: KeyframeStore, map_T_pose: Pose2D, hint: int | None) -> Anchor:
        """Tie a pose to the nearest keyframe; to `hint` where that is as good."""
        rows = [row for row, one in enumerate(store.keyframes) if not one.is_prior]
        if not rows:
            return Anchor(-1, map_T_pose)
        pose = map_T_pose.as_array()
        away = np.hypot(*(store.poses[rows, :2] - pose[:2]).T)
        row = rows[int(np.argmin(away))]
        # Where loops are open still, the nearest may be of the wrong lap.
        if hint is not None and np.hypot(*(store.pose(hint)[:2] - pose[:2])) < away.min() + 0.5:
            row = store.rows[hint]
        if store.prior is not None and away.min() > OWN_WITHIN_M:
            return Anchor(-1, map_T_pose)
        number = store.keyframes[row].number
        self.used.add(number)
        return Anchor(number, Pose2D.from_array(between(store.poses[row], pose)))

    def place(self, store: KeyframeStore, anchor: Anchor) -> Pose2D:
        """Return map_T_pose of an anchor as the map is now."""
        pose = anchor.keyframe_T_pose
        number = anchor.keyframe
        while number in self.successors:
            successor = self.successors[number]
            pose, number = successor.keyframe_T_pose @ pose, successor.keyframe
        if number not in store.rows:
            return pose
        return Pose2D.from_array(store.pose(number)) @ pose

    def forget(self, store: KeyframeStore, numbers: list[int]) -> None:
        """Note where the nearest remaining keyframe is, before some are forgotten."""
        gone = set(numbers)
        for number in gone & self.used:
            self.used.discard(number)
            pose = store.pose(number)
            left = [o.number for o in store.keyframes if o.number not in gone and not o.is_prior]
            if not left:
                self.successors[number] = Anchor(-1, Pose2D.from_array(pose))
                continue
            poses = store.poses[[store.rows[n] for n in left]]
            # Along the same lap rather than across an open loop.
            away = np.hypot(*(poses[:, :2] - pose[:2]).T) + 0.01 * np.abs(np.array(left) - number)
            nearest = left[int(np.argmin(away))]
            step = between(store.pose(nearest), pose)
            self.successors[number] = Anchor(nearest, Pose2D.from_array(step))
            self.used.add(nearest)
