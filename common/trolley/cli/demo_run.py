"""What happens in a demo once its services run: it localizes, gets its places, drives its tour."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from trolley import codes, requests, topics
from trolley.cli import exits
from trolley.cli.demo_recording import duration_s
from trolley.cli.demo_robot import PLACES, START, TOUR
from trolley.cli.printing import say
from trolley.cli.show import Progress, pose_text, seconds_text
from trolley.cli.tour import all_reached, follow_trip
from trolley.client import Robot
from trolley.codes import Refused
from trolley.connection import RobotUnreachable
from trolley.messages import PoseEstimate, SavedPose, TourStatus, Truth, request_params
from trolley.runtime import codec
from trolley.runtime.bus import Sample

R = TypeVar("R")

LOCALIZED_WITHIN_S = 90.0
SERVICE_WITHIN_S = 30.0
RETRY_S = 0.3


class TruthWatch:
    """Listens to where the simulated robot really is: contacts and the closest approach."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0
        self._earlier = 0
        self.closest_m: float | None = None

    @property
    def collisions(self) -> int:
        """Contacts that the robot drove into, over restarts of base too."""
        with self._lock:
            return self._earlier + self._last

    def take(self, sample: Sample) -> None:
        """Take a message (a thread of the bus)."""
        try:
            truth = codec.decode(Truth, sample.payload, sample.encoding)
        except codec.BadPayload:
            return
        with self._lock:
            if truth.collisions < self._last:  # base counts from zero after a restart
                self._earlier += self._last
            self._last = truth.collisions
            if self.closest_m is None or truth.clearance < self.closest_m:
                self.closest_m = truth.clearance


def wait_for_localized(robot: Robot, limit_s: float | None) -> PoseEstimate | None:
    """Show progress until the robot knows where it is; None where that takes over `limit_s`."""
    progress, started_s = Progress(), time.monotonic()
    with robot.subscribe(topics.POSE) as poses:
        while True:
            arrival = poses.next(0.5)
            elapsed_s = time.monotonic() - started_s
            if arrival is not None and arrival.message.state == "localized":
                progress.clear()
                return arrival.message
            state = "starting" if arrival is None else arrival.message.state
            message = "" if arrival is None else f" {arrival.message.message}"
            progress.show(f"{state}, {elapsed_s:.0f} s{message}", state)
            if limit_s is not None and elapsed_s > limit_s:
                progress.clear()
                return None


def wait_for_services(robot: Robot, names: set[str], limit_s: float = SERVICE_WITHIN_S) -> None:
    """Wait until these services do their work, or for `limit_s` at most."""
    deadline_s = time.monotonic() + limit_s
    while time.monotonic() < deadline_s:
        # The viewer's health bears the name of its host too.
        ready = {parts[0].partition("-")[0] for parts in robot.get(topics.HEALTH)}
        if names <= ready:
            return
        time.sleep(RETRY_S)


def wait_for_ports(ports: Sequence[Path], limit_s: float = SERVICE_WITHIN_S) -> None:
    """Wait until these emulated ports are there, or for `limit_s` at most."""
    deadline_s = time.monotonic() + limit_s
    while time.monotonic() < deadline_s and not all(port.exists() for port in ports):
        time.sleep(RETRY_S)


def describe_localized(estimate: PoseEstimate, started_s: float) -> str:
    """A line about a pose that was found."""
    at = pose_text(estimate.pose) if estimate.pose is not None else "nowhere"
    after = f"{time.monotonic() - started_s:.1f} s"
    return f"Localized after {after} at {at}, {estimate.match:.0%} of the beams fit the map."


def patiently(ask: Callable[[], R], within_s: float = SERVICE_WITHIN_S) -> R:
    """Ask again while the service that answers is still starting.

    Raises:
        Refused: It says no, or is still not there after `within_s`.
        RobotUnreachable: Nobody is there after `within_s`.
    """
    deadline_s = time.monotonic() + within_s
    while True:
        try:
            return ask()
        except (Refused, RobotUnreachable) as error:
            is_busy = isinstance(error, Refused) and error.code in codes.UNANSWERED
            is_starting = is_busy or isinstance(error, RobotUnreachable)
            if not is_starting or time.monotonic() > deadline_s:
                raise
        time.sleep(RETRY_S)


def store_places(robot: Robot, map_name: str) -> None:
    """Save the article's places and its tour, unless they are there already."""

    def known_poses() -> set[str]:
        saved = robot.latest(topics.POSES)
        if saved is None:
            raise Refused(codes.NOT_READY, "The tour service is not running.")
        return {pose.name for pose in saved.poses}

    known = patiently(known_poses)
    for name, pose in {"start": START, **PLACES}.items():
        if name not in known:
            place = SavedPose(name=name, map=map_name, pose=pose)
            patiently(lambda place=place: robot.ask(requests.POSES_PUT, place))
    tours = robot.latest(topics.TOURS)
    if tours is None or TOUR.name not in {tour.name for tour in tours.tours}:
        patiently(lambda: robot.ask(requests.TOURS_PUT, TOUR))


def drive_tour(robot: Robot) -> int:
    """Drive the tour, print how each stop ends and a summary; the exit code."""
    watch = TruthWatch()
    closer = robot.connection.listen(topics.SIM_TRUTH.key(robot.name), watch.take)
    try:
        # The planner may still be reading its map.
        status = patiently(
            lambda: robot.ask(requests.TOUR_START, request_params.StartTour(name=TOUR.name))
        )
        status = follow_trip(robot, status.trip)
    finally:
        closer.close()
    _print_summary(status, watch)
    reached = all_reached(status) and len(status.results) == len(TOUR.stops)
    return exits.OK if reached and watch.collisions == 0 else exits.FAILED


def _print_summary(status: TourStatus, watch: TruthWatch) -> None:
    reached = sum(result.state == "reached" for result in status.results)
    took = sum(result.seconds for result in status.results)
    closest = "" if watch.closest_m is None else f", closest approach {watch.closest_m:.2f} m"
    collisions = f"{watch.collisions} collision{'' if watch.collisions == 1 else 's'}"
    say(
        f"Tour {status.state}: {reached} of {len(TOUR.stops)} stops reached "
        f"in {seconds_text(took)}, {collisions}{closest}."
    )
    if status.reason:
        say(f"{status.message} ({status.reason})")


def play_recording(robot: Robot, recording: Path) -> None:
    """Show how far a recorded drive is, until it ends, then a summary."""
    length_s, num_scans = duration_s(recording)
    progress = Progress()
    states: dict[str, int] = {}
    with robot.subscribe(topics.POSE) as poses:
        elapsed_s = 0.0
        while elapsed_s < length_s:
            deadline_s = time.monotonic() + 0.5
            while (left_s := deadline_s - time.monotonic()) > 0.0:
                arrival = poses.next(left_s)
                if arrival is not None:
                    state = arrival.message.state
                    states[state] = states.get(state, 0) + 1
            clock = robot.latest(topics.CLOCK)
            if clock is not None:
                elapsed_s = (clock.stamp_ns - clock.epoch) * 1e-9
            progress.show(
                f"{elapsed_s:.0f} of {length_s:.0f} s, {sum(states.values())} poses, "
                f"{_share(states, sum(states.values()))} localized"
            )
    progress.clear()
    counts = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
    say(
        f"The recording has ended after {length_s:.0f} s: localized at "
        f"{_share(states, num_scans)} of {num_scans} scans ({counts or 'no pose at all'})."
    )


def _share(states: dict[str, int], total: int) -> str:
    return f"{min(1.0, states.get('localized', 0) / max(1, total)):.1%}"
