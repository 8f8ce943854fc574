"""Real processes in real time, killed at random one after another."""

import json
import random
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from bench.faults.robot import SERVICES, Missing, Rig, describe
from bench.faults.saved import lost
from bench.soak.lockstep import PERSON_COMES_AFTER_S, STUCK_AFTER_S, new_results

from trolley import requests
from trolley.codes import Refused
from trolley.connection import RobotUnreachable
from trolley.messages import StopResult, TourStatus

BETWEEN_KILLS_S = (20.0, 60.0)
VICTIMS = (*SERVICES, "router")
# The router is not a child of the supervisor here; its unit restarts it after this time [s].
ROUTER_BACK_AFTER_S = 1.0
READING_EVERY_S = 10.0
STEP_S = 0.2


class Watcher:
    """Watches the trip, and resumes it as a person would."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._results: list[StopResult] = []
        self._trip: str | None = None
        self._said: TourStatus | None = None
        self._paused_s: float | None = None
        self._progress_s = time.monotonic()
        self.reached = 0
        self.missed: Counter[str] = Counter()
        self.pauses: Counter[str] = Counter()
        self.problems: list[str] = []

    def look(self) -> None:
        """Take what is new, and do what a person would."""
        status, now_s = self._rig.tour, time.monotonic()
        if status is not None and status is not self._said:
            self._said = status
            self._hear(status)
        if now_s - self._progress_s > STUCK_AFTER_S:
            self.problems.append(f"stuck: {describe(self._rig)}")
            self._progress_s = now_s
        if status is None or status.state != "paused":
            self._paused_s = None
        elif self._paused_s is None:
            self._paused_s = now_s
            self.pauses[status.reason] += 1
        elif now_s - self._paused_s > PERSON_COMES_AFTER_S:
            self._paused_s = now_s
            try:
                self._rig.ask(requests.TOUR_RESUME)
            except (Refused, RobotUnreachable):
                return  # asked again after a while

    def _hear(self, status: TourStatus) -> None:
        before = self._results if status.trip == self._trip else []
        for result in new_results(before, status.results):
            self._progress_s = time.monotonic()
            if result.state == "reached":
                self.reached += 1
            else:
                self.missed[result.code] += 1
                if not result.code or not result.message:
                    self.problems.append("a stop was missed without a reason")
        self._results, self._trip = list(status.results), status.trip
        if status.state in ("done", "failed", "stopped"):
            self.problems.append(f"the tour without end has ended: {status.message}")


def soak_processes(minutes: float, seed: int, out: Path) -> dict[str, Any]:
    """Drive and kill for so long; readings of the services' memory as lines of `out`."""
    rng = random.Random(seed)
    kills: Counter[str] = Counter()
    memory: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder, Rig(Path(folder)) as rig:
        rig.prepare()
        before = rig.saved()
        watcher = Watcher(rig)
        began_s = time.monotonic()
        end_s = began_s + 60.0 * minutes
        next_kill_s = began_s + rng.uniform(*BETWEEN_KILLS_S)
        next_reading_s = began_s
        ages: dict[str, tuple[int, float]] = {}
        while time.monotonic() < end_s:
            time.sleep(STEP_S)
            watcher.look()
            if time.monotonic() >= next_kill_s:
                victim = rng.choice(VICTIMS)
                _kill(rig, victim)
                kills[victim] += 1
                next_kill_s = time.monotonic() + rng.uniform(*BETWEEN_KILLS_S)
            if time.monotonic() >= next_reading_s:
                next_reading_s += READING_EVERY_S
                memory.append(_read_memory(rig, ages, time.monotonic() - began_s))
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(memory[-1]) + "\n")
        result: dict[str, object] = {
            "minutes": round((time.monotonic() - began_s) / 60.0, 1),
            "kills": dict(kills),
            "reached": watcher.reached,
            "missed": dict(watcher.missed),
            "pauses": dict(watcher.pauses),
            "collisions": rig.collisions,
            "restarts": rig.restarts,
        }
        try:
            rig.wait(lambda: watcher.look() or rig.speed > 0.1, 120.0, "it still drives")
        except Missing as missing:
            watcher.problems.append(f"at the end: {missing} {describe(rig)}")
        result["problems"] = watcher.problems
        result["lost"] = lost(before, rig.saved())
    with out.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"result": result}) + "\n")
    print(json.dumps(result), flush=True)
    return result


def _kill(rig: Rig, victim: str) -> None:
    if victim == "router":
        rig.stop_router()
        time.sleep(ROUTER_BACK_AFTER_S)
        rig.start_router()
        return
    pid = rig.supervisor.children[victim].pid
    if pid is not None:  # else it is just being started again
        rig.kill(pid)


def _read_memory(rig: Rig, ages: dict[str, tuple[int, float]], now_s: float) -> dict[str, Any]:
    """What each service holds [MB], with how long it has run [s]."""
    found: dict[str, Any] = {"at_s": round(now_s, 1)}
    for name, child in rig.supervisor.children.items():
        pid = child.pid
        if pid is None:
            continue
        known, since_s = ages.get(name, (0, 0.0))
        if known != pid:
            ages[name] = (pid, now_s)
            since_s = now_s
        try:
            text = Path(f"/proc/{pid}/status").read_text()
        except FileNotFoundError:
            continue
        lines = [line for line in text.splitlines() if line.startswith("RssAnon")]
        if lines:
            found[name] = [round(now_s - since_s), int(lines[0].split()[1]) // 1024]
    return found
