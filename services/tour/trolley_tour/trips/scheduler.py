"""Starts tours by their schedule."""

from trolley.messages import Tour
from trolley.runtime.service import Service, every
from trolley_tour.charge_monitor import ChargeMonitor
from trolley_tour.stored.checks import parse_utc
from trolley_tour.stored.tours import Tours
from trolley_tour.trips.runner import TripRunner
from trolley_tour.trips.schedule import Minutes, tours_due


class Scheduler:
    """Looks each second what is due, once the host's clock is synchronised."""

    def __init__(
        self, service: Service, tours: Tours, trips: TripRunner, charge: ChargeMonitor
    ) -> None:
        self._service = service
        self._tours = tours
        self._trips = trips
        self._charge = charge
        self._minutes = Minutes()

    @every(1.0, clock="local")
    def _start_due_tours(self) -> None:
        now = self._service.utc_now()
        moment = None if now is None else parse_utc(now)
        if moment is None:
            return
        minute = self._minutes.next(moment.astimezone())
        for tour in [] if minute is None else tours_due(self._tours.items.values(), minute):
            self._start(tour)

    def _start(self, tour: Tour) -> None:
        """Start a tour, unless the battery is low or a trip is under way or paused."""
        log = self._service.log
        if self._charge.is_low:
            self._service.count("schedule/low_battery")
            log.warning("A tour was due but the battery is low", tour=tour.name)
        elif self._trips.is_busy:
            self._service.count("schedule/busy")
            log.warning("A tour was due but another trip is not over", tour=tour.name)
        else:
            log.info("A tour is due", tour=tour.name)
            self._trips.begin(tour)
