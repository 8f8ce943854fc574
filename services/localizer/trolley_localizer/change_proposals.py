"""Proposes changes of the map to people: what has come, and what is gone."""

import numpy as np
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.gridmap import GridMap
from trolley.messages import MapChange, MapChanges
from trolley.messages.request_params import WhichChange
from trolley.runtime.service import Later, Service, answers, every
from trolley_localizer.changes.change_detector import Change
from trolley_localizer.changes.change_file import ChangeFile, from_file, state_file, to_file
from trolley_localizer.map_server import LoadedMap, MapServer
from trolley_localizer.mapper_lease import MapperLease
from trolley_localizer.matching.likelihood_field import LikelihoodField

SAVE_PERIOD_NS = 60_000_000_000
"""Time between two saves of the evidence for changes [ns]."""
_LIKE_SHARE = 0.7
"""Share of their walls that two maps must have in common to be one made from the other."""
_RASTER_M = 0.2
"""Distance that a change must move to be reported anew [m]."""


class ChangeProposals:
    """Publishes what the change detector of the map in use proposes; a person decides."""

    def __init__(self, service: Service, maps: MapServer, lease: MapperLease) -> None:
        self._service = service
        self._maps = maps
        self._lease = lease
        self._published: list[MapChange] | None = None
        self._watched: LoadedMap | None = None
        self._saved_ns = 0

    def open(self, loaded: LoadedMap) -> None:
        """Change to another map, and go on with what was seen on it before."""
        self._published = None
        changes, grid = loaded.localizer.map_watch.changes, loaded.localizer.field.grid
        watched, self._watched = self._watched, None if changes is None else loaded
        kept = self._seen_before(watched, grid, loaded.name)
        if changes is not None and kept is not None:
            if kept.is_of(grid):
                from_file(changes, kept)
            else:
                self._service.log.info(
                    "The map was turned or cropped; restarted change detection", map=loaded.name
                )
        if not self._lease.is_held:
            self._publish(loaded)

    def _seen_before(
        self, watched: LoadedMap | None, grid: GridMap, name: str
    ) -> ChangeFile | None:
        """Return what was seen on a map up to now, which may not be on disk yet."""
        service = self._service
        if watched is None or watched.localizer.map_watch.changes is None:
            return service.state.read(state_file(name), ChangeFile)
        grid_before = watched.localizer.field.grid
        before = to_file(watched.localizer.map_watch.changes, grid_before)
        if watched.name == name:
            return before
        service.save(state_file(watched.name), before)
        own = service.state.read(state_file(name), ChangeFile)
        return before if own is None and _is_like(grid_before, grid) else own

    def repeat(self) -> None:
        """Publish the proposals again at the next occasion."""
        self._published = None

    @every(5.0)
    def propose(self) -> None:
        """Publish what is proposed, if that has changed, and keep what was seen."""
        if self._maps.current is None or self._lease.is_held:
            return
        self._publish(self._maps.current)
        if self._service.monotonic_ns - self._saved_ns >= SAVE_PERIOD_NS:
            self.save()

    def save(self) -> None:
        """Keep what was seen."""
        self._saved_ns = self._service.monotonic_ns
        if self._watched is not None and self._watched.localizer.map_watch.changes is not None:
            localizer = self._watched.localizer
            kept = to_file(self._watched.localizer.map_watch.changes, localizer.field.grid)
            self._service.save(state_file(self._watched.name), kept)

    def _publish(self, loaded: LoadedMap) -> None:
        localizer, service = loaded.localizer, self._service
        found = [change_message(one, localizer.field) for one in localizer.map_watch.find_changes()]
        before = self._published
        if before is not None and _essence(found) == _essence(before):
            return
        if len(found) != len(before or []):
            service.log.info("Changes of the map proposed", count=len(found))
        self._published = found
        message = MapChanges(stamp_ns=service.stamp_ns, map=loaded.name, changes=found)
        service.publish(topics.CHANGES, message)

    @answers(requests.CHANGES_DISMISS)
    def dismiss(self, params: WhichChange) -> Later[MapChange]:
        """Do not propose a change again."""
        loaded = self._maps.ready()
        changes, field = loaded.localizer.map_watch.changes, loaded.localizer.field
        proposed = [] if changes is None else changes.proposed
        change = next((one for one in proposed if one.id == params.id), None)
        if changes is None or change is None:
            raise Refused(codes.UNKNOWN_NAME, f"No change {params.id!r} is proposed.")
        reply: Later[MapChange] = self._service.later()
        changes.dismiss(change)
        message = change_message(change, field)

        def saved(error: OSError | None) -> None:
            if error is None:
                if self._maps.current is loaded and not self._lease.is_held:
                    self._publish(loaded)
                reply.reply(message)
                return
            changes.dismissed = [one for one in changes.dismissed if one.id != params.id]
            why = f"That could not be written to disk: {error.strerror}."
            reply.refuse(Refused(codes.NOT_SAVED, why))

        self._service.save(state_file(loaded.name), to_file(changes, field.grid), saved)
        return reply


def _is_like(one: GridMap, other: GridMap) -> bool:
    """Say whether a map is another one with small changes, under a name of its own."""
    if one.cells.shape != other.cells.shape or one.origin != other.origin:
        return False
    walls, others = one.occupied_mask() != 0, other.occupied_mask() != 0
    return float((walls & others).sum()) >= _LIKE_SHARE * max(int((walls | others).sum()), 1)


def _essence(changes: list[MapChange]) -> list[tuple[object, ...]]:
    """Return what is worth another message: not that time goes by, nor a cell more or less."""
    return [
        (one.id, one.kind, one.score, round(len(one.strokes) ** 0.5), _middle(one))
        for one in changes
    ]


def _middle(change: MapChange) -> tuple[float, float]:
    """Return about where a change is, on a raster."""
    xs, ys = zip(*change.points, strict=True)
    return round(0.5 * (min(xs) + max(xs)) / _RASTER_M), round(
        0.5 * (min(ys) + max(ys)) / _RASTER_M
    )


def change_message(change: Change, field: LikelihoodField) -> MapChange:
    """Return a proposed change as one of `changes`."""
    strokes = field.to_map_points(change.strokes.reshape(-1, 2)).reshape(-1, 2, 2)
    points = field.to_map_points(change.outline)
    return MapChange(
        id=change.id,
        kind=change.kind,
        points=[_point(point) for point in points],
        strokes=[(_point(start), _point(end)) for start, end in strokes],
        width=field.resolution,
        seconds=change.seconds,
        score=min(max(change.score, 0.0), 1.0),
        message=_sentence(change, field.resolution),
    )


def _sentence(change: Change, resolution: float) -> str:
    """Say what has changed."""
    first_row, first_col, last_row, last_col = change.box
    low, high = sorted(((last_row - first_row + 1), (last_col - first_col + 1)))
    size = f"{high * resolution:.1f} x {low * resolution:.1f} m"
    minutes = max(1, round(change.seconds / 60))
    since = "1 minute" if minutes == 1 else f"{minutes} minutes"
    what = "Something has come" if change.kind == "appeared" else "Something is gone"
    return f"{what}: about {size}, seen for {since}."


def _point(point: NDArray[np.float64]) -> tuple[float, float]:
    x, y = (round(float(value), 4) for value in point)
    return x, y
