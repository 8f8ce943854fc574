"""Zones, places, tours and covariances of a map whose coordinates have changed."""

from collections.abc import Collection, Iterable, Set

import msgspec
import numpy as np

from trolley.geometry import Pose2D
from trolley.messages import SavedPose, Stop, Tour, Zone


def moved_zones(zones: Iterable[Zone], old_T_new: Pose2D) -> list[Zone]:
    """Return zones where they lie on the new map."""
    if old_T_new == Pose2D.identity():
        return list(zones)
    new_T_old = old_T_new.inverse()
    return [
        msgspec.structs.replace(
            zone,
            points=[
                (float(x), float(y)) for x, y in new_T_old.transform_points(np.array(zone.points))
            ],
        )
        for zone in zones
    ]


def renamed_zones(zones: Iterable[Zone], taken: Set[str]) -> list[Zone]:
    """Return zones under names that are not taken: a taken one gets a number."""
    names = set(taken)
    found: list[Zone] = []
    for zone in zones:
        name, number = zone.name, 1
        while name in names:
            number += 1
            name = f"{zone.name[:58]} {number}"
        names.add(name)
        found.append(msgspec.structs.replace(zone, name=name))
    return found


def moved_place(place: SavedPose, map_name: str, old_T_new: Pose2D) -> SavedPose:
    """Return a place where it lies on the new map."""
    new_T_old = old_T_new.inverse()
    covariance = place.covariance
    if covariance is not None:
        turn = np.eye(3)
        cos, sin = np.cos(new_T_old.yaw), np.sin(new_T_old.yaw)
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        turned = turn @ np.array(covariance).reshape(3, 3) @ turn.T
        covariance = [float(value) for value in turned.ravel()]
    return msgspec.structs.replace(
        place, map=map_name, pose=new_T_old @ place.pose, covariance=covariance
    )


def moved_tours(
    tours: Iterable[Tour], maps: Collection[str], map_name: str, old_T_new: Pose2D
) -> list[Tour]:
    """Return the tours with poses of their own on some maps, where these lie on the new map."""
    new_T_old = old_T_new.inverse()

    def moved(stop: Stop) -> Stop:
        return msgspec.structs.replace(
            stop,
            pose=None if stop.pose is None else new_T_old @ stop.pose,
            via=[new_T_old @ pose for pose in stop.via],
        )

    mine = (tour for tour in tours if tour.has_poses and tour.map in maps)
    return [
        msgspec.structs.replace(tour, map=map_name, stops=[moved(stop) for stop in tour.stops])
        for tour in mine
    ]
