"""What others hear of the present trip: its status, log lines, and its place in the history."""

from trolley import codes, topics
from trolley.messages import TourStatus
from trolley.runtime.service import Service, every
from trolley_tour import sentences
from trolley_tour.charge_monitor import ChargeMonitor
from trolley_tour.trips.history import TripHistory
from trolley_tour.trips.photos import StopPhotos
from trolley_tour.trips.record import TripRecord


class TripReport:
    """Publishes `tour` on change, and once a second while a trip is under way."""

    def __init__(
        self, service: Service, history: TripHistory, photos: StopPhotos, charge: ChargeMonitor
    ) -> None:
        self._service = service
        self._history = history
        self._photos = photos
        self._charge = charge
        self._record: TripRecord | None = None
        self._published: TourStatus | None = None
        self._num_logged = 0
        self._is_filed = True

    def follow(self, record: TripRecord) -> None:
        """Report on this trip from now on.

        One that is over already is filed again, in case a crash came between its end and the
        history, which keeps a trip only once.
        """
        self._record = record
        self._num_logged, self._is_filed = record.num_results, False

    def status(self) -> TourStatus:
        """The present trip or the last one; without one, whether the robot needs charging."""
        stamp_ns = self._service.stamp_ns
        if self._record is not None:
            return self._record.status(stamp_ns)
        reason, message = "", ""
        if self._charge.is_low:
            reason = codes.LOW_BATTERY
            message = f"{sentences.battery_at(self._charge.fraction)}: charge the robot."
        return TourStatus(
            stamp_ns=stamp_ns, name=None, trip=None, state="idle", reason=reason, message=message
        )

    def update(self) -> None:
        """Publish what changed, log new results, and file a trip that ended."""
        status = self.status()
        if self._published is None or _essence(status) != _essence(self._published):
            self._publish(status)
        record = self._record
        if record is None:
            return
        num_new = record.num_results - self._num_logged
        self._num_logged = record.num_results
        for result in record.results[len(record.results) - num_new :]:
            self._service.log.info(
                result.message, tour=record.tour.name, seconds=round(result.seconds, 1)
            )
        if num_new and record.results[-1].state == "reached":
            self._photos.take(record.trip, record.num_results - 1)
        if record.is_over and not self._is_filed:
            self._is_filed = True
            self._service.log.info(
                record.message, tour=record.tour.name or None, state=record.state
            )
            self._history.add(record.past())

    @every(1.0, clock="local")
    def _publish_each_second(self) -> None:
        if self._record is not None and self._record.is_under_way:
            self._publish(self.status())
        else:
            self.update()

    def _publish(self, status: TourStatus) -> None:
        self._published = status
        self._service.publish(topics.TOUR, status)


def _essence(status: TourStatus) -> tuple[str | int | None, ...]:
    """What is published at once when it changes: all but the time, and what changes with these."""
    return (
        status.trip,
        status.state,
        status.reason,
        status.message,
        status.stop,
        status.lap,
        status.reached,
        status.missed,
    )
