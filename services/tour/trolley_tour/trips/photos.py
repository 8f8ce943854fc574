"""A photo at each stop that is reached, where a camera publishes one."""

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import CameraImage, Photo
from trolley.messages.request_params import WhichPhoto
from trolley.runtime.service import Deadline, Later, Service, Watch, answers
from trolley_tour.trips import photo_files

PATIENCE_S = 2.0
"""How long to wait for the first picture after a stop was reached."""
MAX_JPEG = 700_000
"""As JSON, a larger one would not fit into a message of 1 MiB [bytes]."""
JPEG_BEGINS = b"\xff\xd8\xff"


class StopPhotos:
    """Listens to the camera only while a photo is wanted: a stream of pictures is work.

    Args:
        service: the tour service.
        max_bytes: room for all photos; 0 to take none.
    """

    def __init__(self, service: Service, max_bytes: int) -> None:
        self._service = service
        self._max_bytes = max_bytes
        self._watch: Watch[CameraImage] | None = None
        self._name = ""
        self._since_ns = 0
        self._patience: Deadline | None = None

    def take(self, trip: str, number: int) -> None:
        """Keep the next picture as that of a stop, in place of one that is still waited for."""
        if not self._max_bytes:
            return
        self._give_up()
        self._name = photo_files.name_of(trip, number)
        self._since_ns = self._service.stamp_ns
        self._patience = self._patience or self._service.deadline(self._give_up)
        self._patience.set(PATIENCE_S)
        self._watch = self._service.watch(topics.CAMERA, then=self._update)

    @answers(requests.TOUR_PHOTO)
    def _read(self, params: WhichPhoto) -> Later[Photo]:
        later: Later[Photo] = self._service.later()
        folder = self._service.state.path

        def read() -> bytes | OSError | None:
            try:
                return photo_files.read(folder, params.name, MAX_JPEG)
            except OSError as error:
                return error

        def answer(jpeg: bytes | OSError | None) -> None:
            match jpeg:
                case bytes():
                    later.reply(Photo(name=params.name, jpeg=jpeg))
                case None:
                    message = f"There is no photo {params.name!r}, or not any more."
                    later.refuse(Refused(codes.UNKNOWN_NAME, message, name=params.name))
                case error:
                    message = f"The photo cannot be read: {error.strerror}."
                    later.refuse(Refused(codes.INTERNAL, message))

        self._service.work(read, answer)
        return later

    def _update(self, image: CameraImage) -> None:
        if self._watch is None or image.stamp_ns < self._since_ns:
            return  # the last one of another time
        if not image.jpeg.startswith(JPEG_BEGINS) or len(image.jpeg) > MAX_JPEG:
            self._service.count("photo/no_jpeg")
            return
        self._give_up()
        folder, name, jpeg = self._service.state.path, self._name, image.jpeg

        def keep() -> OSError | None:
            try:
                photo_files.keep(folder, name, jpeg, self._max_bytes)
            except OSError as error:
                return error
            return None

        self._service.work(keep, self._kept)

    def _kept(self, error: OSError | None) -> None:
        if error is not None:
            self._service.count("photo/not_saved")
            self._service.log.limited("photo", "A photo was not saved", why=error.strerror)

    def _give_up(self) -> None:
        """Listen no longer."""
        if self._watch is not None:
            self._service.close_watch(self._watch)
            self._watch = None
        if self._patience is not None:
            self._patience.clear()
