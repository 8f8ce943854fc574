"""Records robots: the viewer's own always, others while somebody follows them."""

from collections.abc import Callable, Set

from trolley.runtime.service import Service, every
from trolley_viz.features.past.record import Record
from trolley_viz.features.past.recorder import KEPT_NS, Recorder, TripRecord
from trolley_viz.features.past.trip_store import TripStore

SAMPLE_PERIOD_S = 0.5
FIRST_SAVE_NS = 60_000_000_000
"""A trip is written to disk for the first time once it is this old."""
GROWTH = 0.2
"""A trip is written again when its record has grown by this share: a long one more seldom."""


class Keeper:
    """Keeps the record of each robot: its last ten minutes, and its trips on disk.

    Args:
        service: whose wire, clocks and files it uses.
        own: the robot that is always recorded.
    """

    def __init__(self, service: Service, own: str) -> None:
        self.store = TripStore(service)
        self._service = service
        self._own = own
        self._recorders: dict[str, Recorder] = {}
        self._left: dict[str, Record] = {}
        """The records of robots that nobody follows any more."""
        self._saved: dict[str, tuple[Record, int]] = {}
        """By robot, the record of a trip and until when it is on disk [ns]."""
        self._loading: set[str] = set()
        """Robots whose trip was begun before this viewer started: its record is being read."""

    def start(self) -> None:
        """Begin to record."""
        self.store.open()
        self.follow(set())

    def stop(self) -> None:
        """Write what is not on disk yet."""
        for robot, recorder in self._recorders.items():
            trip = recorder.trip
            is_due = trip is not None and robot not in self._loading
            if trip is not None and is_due and self._is_unsaved(robot, trip):
                self.store.save_now((robot, trip.trip), trip.record)

    def follow(self, robots: Set[str]) -> None:
        """Record these robots besides the own one."""
        wanted = {self._own, *robots}
        if wanted == self._recorders.keys():
            return
        for robot in self._recorders.keys() - wanted:
            recorder = self._recorders.pop(robot)
            recorder.close()
            self._left[robot] = recorder.record
            self._save_trip(robot, recorder)
        oldest_ns = self._service.since_boot_ns - KEPT_NS
        self._left = {name: one for name, one in self._left.items() if one.last_ns > oldest_ns}
        for robot in wanted - self._recorders.keys():
            recorder = self._recorders[robot] = Recorder(self._service, robot)
            recorder.record = self._left.pop(robot, recorder.record)

    def lately(self, robot: str) -> Record:
        """The last ten minutes of a robot, as they are now."""
        recorder = self._recorders.get(robot)
        return Record.empty() if recorder is None else recorder.record

    def trip(self, robot: str, trip: str, then: Callable[[Record | str], None]) -> None:
        """Find the record of a trip; a sentence where it cannot be read."""
        recorder = self._recorders.get(robot)
        if recorder is not None and recorder.trip is not None and recorder.trip.trip == trip:
            then(recorder.trip.record.copy())
        else:
            self.store.read((robot, trip), then)

    def has_trip(self, robot: str, trip: str) -> bool:
        """Whether there is a record of a trip."""
        recorder = self._recorders.get(robot)
        running = None if recorder is None else recorder.trip
        is_running = running is not None and running.trip == trip
        return is_running or (robot, trip) in self.store.names

    @every(SAMPLE_PERIOD_S, clock="local")
    def sample(self) -> None:
        """Take a sample of each robot, and write what is due."""
        if not self.store.is_open:
            return  # a trip under way may have a file already
        for robot, recorder in self._recorders.items():
            before = recorder.trip
            recorder.sample()
            if recorder.trip is not None and recorder.trip is not before:
                if before is not None:
                    self._save(robot, before)
                self._go_on(robot, recorder.trip)
            self._save_trip(robot, recorder)

    # Inside.
    def _go_on(self, robot: str, trip: TripRecord) -> None:
        """Take in what an earlier run of the viewer recorded of the same trip."""
        if (robot, trip.trip) not in self.store.names:
            return
        self._loading.add(robot)

        def read(found: Record | str) -> None:
            self._loading.discard(robot)
            if isinstance(found, Record):
                found.go_on(trip.record)
                trip.record = found

        self.store.read((robot, trip.trip), read)

    def _save_trip(self, robot: str, recorder: Recorder) -> None:
        """Write a trip that has ended, or grown enough."""
        trip = recorder.trip
        if trip is None:
            return
        record, first_ns = trip.record, trip.record.first_ns or 0
        saved, until_ns = self._saved.get(robot, (None, 0))
        since_ns = until_ns if saved is record else first_ns
        age_ns = record.last_ns - first_ns
        has_grown = record.last_ns - since_ns > GROWTH * age_ns
        is_over = robot not in self._recorders or recorder.is_trip_over
        if is_over or (age_ns >= FIRST_SAVE_NS and has_grown):
            self._save(robot, trip)

    def _save(self, robot: str, trip: TripRecord) -> None:
        """Write a trip, unless it is on disk as it is."""
        if robot not in self._loading and self._is_unsaved(robot, trip):
            self._saved[robot] = trip.record, trip.record.last_ns
            self.store.save((robot, trip.trip), trip.record.copy())

    def _is_unsaved(self, robot: str, trip: TripRecord) -> bool:
        saved, until_ns = self._saved.get(robot, (None, 0))
        return trip.record.first_ns is not None and (
            saved is not trip.record or until_ns < trip.record.last_ns
        )
