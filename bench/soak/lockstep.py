"""Hours of tours in lock-step: people walk about, services die and come back, stops are pressed."""

import ctypes
import gc
import hashlib
import json
import math
import os
import random
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
from bench.harness.drives import CORRIDOR, ENTRANCE, KITCHEN, make_config
from bench.harness.wandering import APARTMENT, START, write_world

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import BaseState, PoseEstimate, Stop, StopResult, Tour, TourStatus, Truth
from trolley.messages.request_params import StartTour
from trolley.runtime.bus import Sample
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService

SERVICES: dict[str, Callable[..., Service]] = {
    "base": BaseService,
    "localizer": LocalizerService,
    "planner": PlannerService,
    "tour": TourService,
}
DWELL_S = 20.0
# A service dies this long after the last one came back, and is away for so long [s].
BETWEEN_RESTARTS_S, AWAY_S = (60.0, 240.0), (0.5, 5.0)
BETWEEN_STOPS_S = 600.0
# A stop that was pressed must end all motion within this time [s] ...
STANDS_WITHIN_S = 1.5
STANDS_MPS, DRIVES_MPS = 0.01, 0.2
# ... and somebody resumes the robot after this one [s].
PERSON_COMES_AFTER_S = 5.0
# A tour whose next stop takes longer than all tries to drive there is stuck [s].
STUCK_AFTER_S = 420.0
STEP_S = 0.5
ALARMS = (codes.BLIND, codes.DOES_NOT_OBEY)
"""What base must never say here, where the lidar sees and the motors obey."""
ENDED = ("idle", "done", "failed", "stopped")
_C = ctypes.CDLL(None)


class Soak:
    """One robot, driven round and round.

    Args:
        folder: for its files and its state.
        seed: of the world, the services and everything that happens to them.
        world: where it drives, `apartment` or `real`.
        view_deg: how far round its lidar sees [deg].
    """

    def __init__(
        self, folder: Path, seed: int, world: str = "apartment", view_deg: float = 360.0
    ) -> None:
        view = None if view_deg >= 360.0 else math.radians(view_deg)
        path = write_world(folder, name=world, people=True, field_of_view=view)
        rest = f'[base.simulated]\nworld = "{path}"\nseed = {seed}\n'
        self._config = make_config(APARTMENT, START, rest + "[planner]\nturn_to_find = true\n")
        self.lockstep = Lockstep(self._config.robot.name, seed, folder / "state")
        self._random = random.Random(seed)
        self._digest = hashlib.sha256()
        self._truth: Truth | None = None
        self._tour: TourStatus | None = None
        self._base: BaseState | None = None
        self.alarms: Counter[str] = Counter()
        self._pose: PoseEstimate | None = None
        self._collisions_before = 0
        self.closest_m = math.inf
        self.reached = 0
        self.missed: Counter[str] = Counter()
        self.restarts: Counter[str] = Counter()
        self.pauses: Counter[str] = Counter()
        self.problems: list[str] = []
        self.stops_pressed = 0
        self.slowest_stop_s = 0.0
        self.driven_m = 0.0
        self._results: list[StopResult] = []
        self._trip: str | None = None
        self._progress_s = 0.0
        self._paused_s: float | None = None
        self._next_restart_s = self._random.uniform(*BETWEEN_RESTARTS_S)
        self._next_stop_s = BETWEEN_STOPS_S
        for topic, hear in (
            (topics.SIM_TRUTH, self._hear_truth),
            (topics.TOUR, self._hear_tour),
            (topics.BASE, self._hear_base),
            (topics.POSE, self._hear_pose),
        ):
            self.lockstep.bus.subscribe(topic.key(self.lockstep.robot), hear)
        self.services = {
            name: self.lockstep.add(make(self._config)) for name, make in SERVICES.items()
        }
        """Those that live, by name."""

    def leave_alone(self) -> None:
        """Let no service die any more, and nobody press stop."""
        self._next_restart_s = self._next_stop_s = math.inf

    # What is heard.
    def _hear_truth(self, sample: Sample) -> None:
        self._digest.update(sample.payload)
        truth = msgspec.msgpack.decode(sample.payload, type=Truth)
        last = self._truth
        if last is not None:
            if truth.collisions < last.collisions:  # another run of base counts from 0
                self._collisions_before += last.collisions
            elif truth.collisions > last.collisions:
                self._note_contact(truth)
            self.driven_m += truth.pose.distance_to(last.pose)
        self.closest_m = min(self.closest_m, truth.clearance)
        self._truth = truth

    def _note_contact(self, truth: Truth) -> None:
        pose, twist = truth.pose, truth.twist
        base = "" if self._base is None else f"; base: {self._base.mode}: {self._base.message}"
        self._note(
            f"drove into something at x {pose.x:.2f}, y {pose.y:.2f} m, yaw {pose.yaw:.2f} rad, "
            f"with {twist.vx:.2f} m/s, {twist.wz:.2f} rad/s{base}"
        )

    def _hear_tour(self, sample: Sample) -> None:
        status = self._tour = msgspec.msgpack.decode(sample.payload, type=TourStatus)
        before = self._results if status.trip == self._trip else []
        for result in new_results(before, status.results):
            self._progress_s = self.lockstep.now_s
            if result.state == "reached":
                self.reached += 1
            else:
                self.missed[result.code] += 1
                if not result.code or not result.message:
                    self._note("a stop was missed without a reason")
        self._results, self._trip = list(status.results), status.trip

    def _hear_base(self, sample: Sample) -> None:
        base = msgspec.msgpack.decode(sample.payload, type=BaseState)
        reason_before = "" if self._base is None else self._base.reason
        if base.reason in ALARMS and base.reason != reason_before:
            self.alarms[base.reason] += 1
            self._note(f"false alarm: {base.mode}: {base.message}")
        self._base = base

    def _hear_pose(self, sample: Sample) -> None:
        self._pose = msgspec.msgpack.decode(sample.payload, type=PoseEstimate)

    def _note(self, problem: str) -> None:
        self.problems.append(f"{self.lockstep.now_s:.0f} s: {problem}")

    @property
    def collisions(self) -> int:
        """Contacts that the robot drove into, over all runs of base."""
        return self._collisions_before + (0 if self._truth is None else self._truth.collisions)

    @property
    def digest(self) -> str:
        """Of everything that `sim/truth` said: the same for the same seed."""
        return self._digest.hexdigest()[:16]

    # What happens.
    def run(self, seconds: float) -> None:
        """Let time pass, with all its events."""
        end_s = self.lockstep.now_s + seconds
        while self.lockstep.now_s < end_s:
            self.lockstep.run(STEP_S)
            self._be_a_person()
            if self.lockstep.now_s >= self._next_restart_s:
                self._restart()
            if self.lockstep.now_s >= self._next_stop_s:
                self._press_stop()
            if self.lockstep.now_s - self._progress_s > STUCK_AFTER_S:
                state = None if self._tour is None else (self._tour.state, self._tour.message)
                self._note(f"stuck: {state}")
                self._progress_s = self.lockstep.now_s
                self._try(lambda: self.lockstep.ask(requests.TOUR_SKIP))

    def _be_a_person(self) -> None:
        """Start the tour if there is none, and resume what waits for a person."""
        tour = self._tour
        if tour is None or tour.state in ENDED:
            if self._pose is not None and self._pose.state == "localized":
                if tour is not None and tour.state != "idle":
                    self._note(f"the tour without end has ended: {tour.message}")
                places = (CORRIDOR, ENTRANCE, KITCHEN, START)
                stops = [
                    Stop(pose=place, dwell=DWELL_S, retries=1, on_failure="skip")
                    for place in places
                ]
                request = StartTour(tour=Tour(name="round", stops=stops, repeat=0))
                self._try(lambda: self.lockstep.ask(requests.TOUR_START, request))
        elif tour.state != "paused":
            self._paused_s = None
        elif self._paused_s is None:
            self._paused_s = self.lockstep.now_s
            self.pauses[tour.reason] += 1
        elif self.lockstep.now_s - self._paused_s >= PERSON_COMES_AFTER_S:
            if self._base is not None and self._base.mode == "stopped":
                self._try(lambda: self.lockstep.ask(requests.BASE_RESUME))
            self._try(lambda: self.lockstep.ask(requests.TOUR_RESUME))

    def _try(self, ask: Callable[[], object]) -> None:
        """Ask; a refusal is no trouble, since it is asked again at the next step."""
        try:
            ask()
        except Refused as refused:
            self.pauses[f"asked too early: {refused.code}"] += 1

    def _restart(self) -> None:
        """Let one service die without notice and come back."""
        name = self._random.choice(list(SERVICES))
        self.lockstep.kill(name)
        gc.collect()  # what a process that dies gives back at once
        self.lockstep.run(self._random.uniform(*AWAY_S))
        self.services[name] = self.lockstep.add(SERVICES[name](self._config))
        self.restarts[name] += 1
        self._next_restart_s = self.lockstep.now_s + self._random.uniform(*BETWEEN_RESTARTS_S)

    def _press_stop(self) -> None:
        """Stop the robot while it drives, and check that it stands still."""
        if not self._drives():
            return
        began_s = self.lockstep.now_s
        self._next_stop_s = began_s + BETWEEN_STOPS_S
        self.lockstep.ask(requests.BASE_STOP)
        self.stops_pressed += 1
        if not self.lockstep.run_until(self._stands, STANDS_WITHIN_S):
            self._note(f"did not stand {STANDS_WITHIN_S} s after a stop")
        self.slowest_stop_s = max(self.slowest_stop_s, self.lockstep.now_s - began_s)
        self.lockstep.run(PERSON_COMES_AFTER_S)
        if not self._stands():
            self._note("moved while it was stopped")
        self.lockstep.ask(requests.BASE_RESUME)

    def _drives(self) -> bool:
        return self._truth is not None and abs(self._truth.twist.vx) > DRIVES_MPS

    def _stands(self) -> bool:
        twist = None if self._truth is None else self._truth.twist
        return twist is not None and abs(twist.vx) + 0.2 * abs(twist.wz) < STANDS_MPS

    def reading(self) -> dict[str, Any]:
        """How it stands now, as plain values."""
        gc.collect()
        _C.malloc_trim(0)  # else it counts what the C library keeps for the next service, too
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return {
            "hours": round(self.lockstep.now_s / 3600.0, 4),
            "cpu_s": round(time.process_time(), 1),
            "memory_mb": round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 2),
            "objects": len(gc.get_objects()),
            "state_kb": round(
                sum(one.stat().st_size for one in self.lockstep.state.rglob("*") if one.is_file())
                / 1024,
                1,
            ),
            "driven_m": round(self.driven_m, 1),
            "reached": self.reached,
            "missed": dict(self.missed),
            "pauses": dict(self.pauses),
            "restarts": dict(self.restarts),
            "stops_pressed": self.stops_pressed,
            "slowest_stop_s": round(self.slowest_stop_s, 3),
            "false_alarms": dict(self.alarms),
            "collisions": self.collisions,
            "closest_m": round(self.closest_m, 4),
            "problems": list(self.problems),
            "truth": self.digest,
        }

    def close(self) -> None:
        """Stop everything."""
        self.lockstep.close()


def new_results(before: list[StopResult], after: list[StopResult]) -> list[StopResult]:
    """Return the new entries of a list that grows at its end and drops its oldest."""
    for num_new in range(len(after)):
        kept = after[: len(after) - num_new]
        if before[len(before) - len(kept) :] == kept and len(kept) <= len(before):
            return after[len(after) - num_new :]
    return after


def soak(robot: Soak, hours: float, seed: int, every_s: float, out: Path | None) -> dict[str, Any]:
    """Run it; a reading each `every_s` of simulated time, kept as a line of `out`."""
    readings: list[dict[str, Any]] = []
    while robot.lockstep.now_s < hours * 3600.0 - STEP_S:
        robot.run(min(every_s, hours * 3600.0 - robot.lockstep.now_s))
        reading = {"seed": seed, **robot.reading()}
        readings.append(reading)
        line = json.dumps(reading)
        print(line, flush=True)
        if out is not None:
            with out.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
    robot.close()
    return readings[-1]
