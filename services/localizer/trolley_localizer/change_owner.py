"""The part of the service that proposes changes of the map, where it has the permission."""

from functools import partial

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.gridmap import GridMap
from trolley.messages import MapChange, MapChanges
from trolley.messages.request_params import WhichChange
from trolley.runtime.service import Later, answers, every
from trolley_localizer.changes.change_detector import ChangeDetector
from trolley_localizer.changes.change_file import ChangeFile, from_file, state_file, to_file
from trolley_localizer.core import Localizer
from trolley_localizer.map_owner import MapOwner
from trolley_localizer.to_messages import change_message

SAVE_PERIOD_NS = 60_000_000_000

# Share of the walls that maps have in common if one was made of the other.
_LIKE = 0.7

Watched = tuple[ChangeDetector, GridMap, str]
"""What was seen on a map, the map, and its name."""


class ChangeOwner(MapOwner):
    """Watches for what has come or gone, and says so; a person decides."""

    _proposed: list[MapChange] | None = None
    _watched: Watched | None = None
    _changes_saved_ns = 0

    def on_map(self, localizer: Localizer, name: str) -> None:
        """Go on with what was seen on this map before."""
        self._proposed = None
        changes, grid = localizer.changes, localizer.field.grid
        watched = self._watched
        self._watched = None if changes is None else (changes, grid, name)
        kept = self._kept_of(watched, grid, name)
        if changes is not None and kept is not None:
            if kept.is_of(grid):
                from_file(changes, kept)
            else:
                self.log.info("The map was turned or cut; watching for changes anew", map=name)
        if not self.is_yielding:
            self._publish_changes(localizer)

    def _kept_of(self, watched: Watched | None, grid: GridMap, name: str) -> ChangeFile | None:
        """Return what was seen on a map up to now, which may not be on disk yet."""
        if watched is None:
            return self.state.read(state_file(name), ChangeFile)
        changes, grid_before, name_before = watched
        before = to_file(changes, grid_before)
        if name_before == name:
            return before
        self.save(state_file(name_before), before)
        own = self.state.read(state_file(name), ChangeFile)
        return before if own is None and _is_like(grid_before, grid) else own

    def took_back(self) -> None:
        """Say again what is proposed."""
        self._proposed = None
        super().took_back()

    @every(5.0)
    def propose_changes(self) -> None:
        """Publish what is proposed, if that has changed, and keep what was seen."""
        if self._localizer is None or self.is_yielding:
            return
        self._publish_changes(self._localizer)
        if self.monotonic_ns - self._changes_saved_ns >= SAVE_PERIOD_NS:
            self.save_changes()

    def save_changes(self) -> None:
        """Keep what was seen."""
        self._changes_saved_ns = self.monotonic_ns
        if self._watched is not None:
            changes, grid, name = self._watched
            self.save(state_file(name), to_file(changes, grid))

    def _publish_changes(self, localizer: Localizer) -> None:
        found = [change_message(one, localizer.field) for one in localizer.find_changes()]
        before = self._proposed
        if before is not None and _essence(found) == _essence(before):
            return
        if len(found) != len(before or []):
            self.log.info("ChangeDetector of the map proposed", count=len(found))
        self._proposed = found
        message = MapChanges(stamp_ns=self.stamp_ns, map=self._map_name or "", changes=found)
        self.publish(topics.CHANGES, message)

    @answers(requests.CHANGES_DISMISS)
    def dismiss_change(self, params: WhichChange) -> Later[MapChange]:
        """Do not propose a change again."""
        localizer = self.ready()
        changes = localizer.changes
        proposed = [] if changes is None else changes.proposed
        change = next((one for one in proposed if one.id == params.id), None)
        if changes is None or change is None:
            raise Refused(codes.UNKNOWN_NAME, f"No change {params.id!r} is proposed.")
        reply: Later[MapChange] = self.later()
        before = changes.dismissed
        changes.dismiss(change)
        message = change_message(change, localizer.field)

        def saved(error: OSError | None) -> None:
            if error is None:
                self._publish_changes(localizer)
                reply.reply(message)
                return
            changes.dismissed = before
            why = f"That could not be written to disk: {error.strerror}."
            reply.refuse(Refused(codes.NOT_SAVED, why))

        kept = to_file(changes, localizer.field.grid)
        self.work(partial(self._try_write, state_file(self._map_name or ""), kept), saved)
        return reply


def _is_like(one: GridMap, other: GridMap) -> bool:
    """Say whether a map is another one with small changes, under a name of its own."""
    if one.cells.shape != other.cells.shape or one.origin != other.origin:
        return False
    walls, others = one.occupied_mask() != 0, other.occupied_mask() != 0
    return float((walls & others).sum()) >= _LIKE * max(int((walls | others).sum()), 1)


def _essence(changes: list[MapChange]) -> list[tuple[object, ...]]:
    """Return what is worth another message: not that time goes by, nor a cell more or less."""
    return [
        (one.id, one.kind, one.score, round(len(one.strokes) ** 0.5), _middle(one))
        for one in changes
    ]


def _middle(change: MapChange) -> tuple[float, float]:
    """Return about where a change is, on a raster of 0.2 m."""
    xs, ys = zip(*change.points, strict=True)
    return round(0.5 * (min(xs) + max(xs)) / 0.2), round(0.5 * (min(ys) + max(ys)) / 0.2)
