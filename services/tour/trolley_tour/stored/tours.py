"""Stored tours: stored keys, requests, `tours.toml`, and the stream `tours`."""

from collections.abc import Mapping

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import Tour
from trolley.messages import Tours as TourList
from trolley.messages.request_params import Named
from trolley.names import canonical
from trolley.runtime.service import Later, Service, answers, gets, on, on_delete
from trolley.suggestions import did_you_mean
from trolley_tour.robot_state import RobotState
from trolley_tour.state_files import StateFiles
from trolley_tour.stored import checks
from trolley_tour.stored.named_store import Answer, NamedStore, WishLog, answer_later

TOURS_FILE = "tours.toml"


class Tours:
    """The stored tours by name."""

    def __init__(self, service: Service, files: StateFiles, robot: RobotState) -> None:
        self._service = service
        self._files = files
        self._robot = robot
        self._wishes = WishLog(service, "tours")
        self._store: NamedStore[Tour] = NamedStore(
            "tour",
            lambda tours: checks.ToursFile(tours=tours),
            lambda content, then: files.save(TOURS_FILE, content, then),
            self._publish,
        )

    def start(self) -> None:
        """Read what is stored and publish it."""
        file = self._files.read(TOURS_FILE, checks.ToursFile)
        self._store.items, doubled = checks.by_name(file.tours if file else [])
        self._files.say_doubled(TOURS_FILE, doubled)
        self._publish()

    @property
    def items(self) -> Mapping[str, Tour]:
        """What is stored, by name."""
        return self._store.items

    def find(self, name: str) -> Tour:
        """The tour of this name; raises `Refused`."""
        tour = self._store.items.get(checks.plain_name(name))
        if tour is None:
            hint = did_you_mean(name, self._store.items)
            raise Refused(codes.UNKNOWN_NAME, f"There is no tour {name!r}. {hint}", name=name)
        return tour

    def _put(self, tour: Tour, key: str, answer: Answer[Tour]) -> None:
        # A map in the making still changes its name, and where things lie on it.
        on_map = None if self._robot.is_mapping else self._robot.map_name
        stored = self._store.items.get(canonical(key))
        checked = checks.checked_tour(tour, key, on_map, stored)
        self._store.change(lambda items: (checks.with_item(items, checked), checked), answer)

    @on(topics.STORED_TOUR)
    def _put_by_key(self, tour: Tour, name: str) -> None:
        self._put(tour, name, self._wishes.note_result_of(name))

    @on_delete(topics.STORED_TOUR)
    def _delete_by_key(self, *chunks: str) -> None:
        self._store.delete(checks.only_chunk(chunks), self._wishes.note_result_of(chunks[0]))

    @answers(requests.TOURS_PUT)
    def _put_on_request(self, tour: Tour) -> Later[Tour]:
        later: Later[Tour] = self._service.later()
        self._put(tour, tour.name, answer_later(later))
        return later

    @answers(requests.TOURS_DELETE)
    def _delete_on_request(self, params: Named) -> Later[Tour]:
        later: Later[Tour] = self._service.later()
        self._store.delete(params.name, answer_later(later))
        return later

    @gets(topics.STORED_TOUR)
    def _get(self, parameters: dict[str, str]) -> dict[tuple[str, ...], Tour]:
        del parameters
        return {(name,): tour for name, tour in self._store.items.items()}

    def _publish(self) -> None:
        tours = list(self._store.items.values())
        self._service.publish(topics.TOURS, TourList(stamp_ns=self._service.stamp_ns, tours=tours))
