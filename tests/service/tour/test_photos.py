"""A photo at each stop, where a camera publishes one."""

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import CameraImage, PastTrip, Stop
from trolley.messages.request_params import WhichPhoto
from trolley.runtime.service import Service, every
from trolley_tour.trips import photo_files

if TYPE_CHECKING:
    from .conftest import Home, Plan

JPEG = b"\xff\xd8\xff\xe0"


class Camera(Service):
    """A program with a camera: each picture is another one."""

    name = "camera"

    def __init__(self, begins: bytes = JPEG, late_s: float = 0.0) -> None:
        self.begins = begins
        self.late_ns = round(late_s * 1e9)
        self.taken: list[CameraImage] = []

    @every(0.25, clock="local")
    def tick(self) -> None:
        jpeg = self.begins + str(len(self.taken)).encode()
        self.taken.append(CameraImage(stamp_ns=max(0, self.stamp_ns - self.late_ns), jpeg=jpeg))
        self.publish(topics.CAMERA, self.taken[-1])


def past(home: "Home") -> PastTrip:
    return home.lockstep.ask(requests.TOUR_HISTORY)[0]


def photo(home: "Home", name: str) -> bytes:
    return home.lockstep.ask(requests.TOUR_PHOTO, WhichPhoto(name=name)).jpeg


def test_each_stop_that_is_reached_has_a_photo_taken_there(home: "Home", plan: "type[Plan]"):
    camera = home.lockstep.add(Camera())
    home.planner.script = [plan(), plan(state="failed", reason=codes.BLOCKED), plan()]
    goals = home.lockstep.record(topics.GOAL)
    home.start("corridor", Stop(name="entrance", on_failure="skip"), "kitchen")
    home.run_until("done")
    home.lockstep.run(1.0)
    trip = past(home)
    assert [bool(one) for one in trip.photos] == [True, False, True]
    first, last = (photo(home, one) for one in trip.photos if one)
    number = [image.jpeg for image in camera.taken].index
    arrivals = {one.id: one.stamp_ns for one in reversed(goals) if one.state == "arrived"}
    reached_ns = sorted(arrivals.values())
    assert number(first) < number(last)
    for jpeg, arrived_ns in zip((first, last), reached_ns, strict=True):
        assert 0 <= camera.taken[number(jpeg)].stamp_ns - arrived_ns < 1_000_000_000


def test_without_a_camera_a_trip_has_no_photo(home: "Home"):
    home.start("corridor", "kitchen")
    home.run_until("done")
    assert past(home).photos == []
    with pytest.raises(Refused) as caught:
        photo(home, "nosuch-0")
    assert caught.value.code == codes.UNKNOWN_NAME


@pytest.mark.parametrize("camera", [Camera(begins=b"\x89PNG"), Camera(late_s=60.0)])
def test_neither_what_is_no_jpeg_nor_an_old_picture_is_kept(home: "Home", camera: Camera):
    home.lockstep.add(camera)
    home.start("kitchen")
    home.run_until("done")
    home.lockstep.run(5.0)
    assert past(home).photos == []


def test_the_camera_is_listened_to_only_at_stops(home: "Home"):
    camera = home.lockstep.add(Camera(begins=b"no picture"))
    home.start("kitchen")
    home.run_until("done")
    home.lockstep.run(10.0)
    heard = home.lockstep.counters("tour")["photo/no_jpeg"]
    assert 0 < heard <= 9 < len(camera.taken) / 4


def test_the_oldest_photos_make_room(tmp_path: Path):
    for number in range(6):
        photo_files.keep(tmp_path, f"trip-{number}", bytes(100), 350)
    assert photo_files.names(tmp_path) == {"trip-3", "trip-4", "trip-5"}
    photo_files.keep(tmp_path, "trip-5", bytes(50), 350)
    assert photo_files.read(tmp_path, "trip-5", 1000) == bytes(50)
    assert photo_files.read(tmp_path, "trip-0", 1000) is None


def test_the_oldest_photos_make_room_also_where_the_clock_was_set_back(tmp_path: Path):
    for number in range(3):
        photo_files.keep(tmp_path, f"trip-{number}", bytes(100), 350)
    next_year_s = time.time() + 3e7
    for path in (tmp_path / photo_files.FOLDER).iterdir():
        os.utime(path, (next_year_s, next_year_s))
    for number in range(3, 6):
        photo_files.keep(tmp_path, f"trip-{number}", bytes(100), 350)
    assert photo_files.names(tmp_path) == {"trip-3", "trip-4", "trip-5"}
