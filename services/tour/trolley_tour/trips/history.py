"""The history of trips: filed when they end, and the request `tour/history`."""

import datetime
from collections import deque
from collections.abc import Set

from msgspec import structs

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import PastTrip
from trolley.messages.request_params import AskHistory
from trolley.runtime.service import Later, Service, answers, every
from trolley_tour.problems import Problems
from trolley_tour.stored.checks import parse_utc
from trolley_tour.trips import history_file, photo_files
from trolley_tour.trips.history_file import FILE, Outcome

MAX_REPLY_BYTES = 900_000
"""A message is at most 1 MiB; older trips that do not fit are left out."""
PHOTO_NAME_BYTES = 40
"""What the name of a photo adds to a reply, at most."""
FILE_AGAIN_S = 5.0
"""The disk may have room by then."""
MAX_UNFILED = 100
"""Past trips that wait for room on the disk; of more than these the newest are kept."""


class TripHistory:
    """The past trips; those older than `days` are dropped."""

    def __init__(self, service: Service, problems: Problems, days: float) -> None:
        self._service = service
        self._problems = problems
        self._days = days
        self._unfiled: deque[PastTrip] = deque(maxlen=MAX_UNFILED)

    def add(self, past: PastTrip) -> None:
        """File a trip that ended, as soon as the disk takes it."""
        self._unfiled.append(past)
        if len(self._unfiled) == 1:
            self._file_next()

    @answers(requests.TOUR_HISTORY)
    def _read(self, params: AskHistory) -> Later[list[PastTrip]]:
        since: datetime.datetime | None = None
        if params.since is not None:
            since = parse_utc(params.since)
            if since is None:
                raise Refused(codes.BAD_REQUEST, f"{params.since!r} is not an ISO 8601 time.")
        later: Later[list[PastTrip]] = self._service.later()

        def answer(outcome: Outcome) -> None:
            self._report(outcome)
            if outcome.problem is None:
                later.reply([*outcome.trips])
            else:
                message = f"The history cannot be read: {outcome.problem}."
                later.refuse(Refused(codes.INTERNAL, message))

        folder = self._service.state.path

        def read() -> Outcome:
            photos = photo_files.names(folder)
            room = MAX_REPLY_BYTES - len(photos) * PHOTO_NAME_BYTES
            outcome = history_file.read_trips(folder, since, params.limit, room)
            return outcome._replace(trips=tuple(_with_photos(one, photos) for one in outcome.trips))

        self._service.work(read, answer)
        return later

    @every(FILE_AGAIN_S, clock="local")
    def _file_next(self) -> None:
        """File the oldest that waits; the next follows once that is done."""
        if not self._unfiled:
            return
        folder, days, past = self._service.state.path, self._days, self._unfiled[0]

        def filed(outcome: Outcome) -> None:
            self._report(outcome)
            if outcome.problem is not None:
                self._service.count("history/not_saved")
                problem = f"The history of trips could not be saved: {outcome.problem}."
                self._problems.set(FILE, problem)
                return
            self._problems.set(FILE, None)
            if self._unfiled and self._unfiled[0] is past:
                self._unfiled.popleft()
                self._file_next()

        self._service.work(lambda: history_file.keep_trip(folder, past, days), filed)

    def _report(self, outcome: Outcome) -> None:
        """Report what was found broken in the file."""
        if outcome.kept is not None:
            self._service.log.error(
                "The history cannot be read and was set aside", kept=outcome.kept
            )
            self._problems.set(f"{FILE} before", f"{FILE} could not be read and was set aside.")
        if outcome.num_unreadable:
            self._service.count("history/unreadable", outcome.num_unreadable)


def _with_photos(trip: PastTrip, photos: Set[str]) -> PastTrip:
    """A trip with the photos that are still there."""
    first = trip.reached + trip.missed - len(trip.results)
    named = [photo_files.name_of(trip.trip, first + index) for index in range(len(trip.results))]
    found = [name if name in photos else "" for name in named]
    return structs.replace(trip, photos=found if any(found) else [])
