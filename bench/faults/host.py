"""What the host does to the services: full or read-only disk, wrong clock, no CPU, no memory."""

import contextlib
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from bench.faults.cases import COMMAND_LOST_S, GRAIN_S, HOW_IT_STANDS, Fault, Outcome, disturb
from bench.faults.messages import ANSWERED_WITHIN_S
from bench.faults.robot import ROBOT, Missing, Rig, describe
from bench.faults.saved import lost
from bench.harness.drives import KITCHEN

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import SavedPose, Zone
from trolley.messages.request_params import Named
from trolley.requests import Request

SQUARE = [(-7.0, -9.0), (-6.0, -9.0), (-6.0, -8.0)]
DISK_BYTES = 4 << 20
DRIVES_S = 10.0
YEAR_S = 365 * 86_400
CLOCK_SHIFT = Path(__file__).with_name("clock_shift.c")
CGROUP = Path("/sys/fs/cgroup/memory")
# Requests that are refused whatever they contain, and what they contain.
BALLAST: dict[str, Request[Any, Any]] = {
    "base": requests.BASE_RESUME,
    "localizer": requests.MAP_LIST,
    "planner": requests.GOAL_CANCEL,
    "tour": requests.TOUR_HISTORY,
}
BALLAST_BYTES, BALLAST_AT_ONCE = 1_000_000, 20
BUSY = "while True: pass"


def is_root() -> bool:
    """Whether disks can be mounted here."""
    return os.geteuid() == 0


# Disks.
@contextlib.contextmanager
def small_disk() -> Iterator[Path]:
    """A disk of 4 MB of its own."""
    with tempfile.TemporaryDirectory() as name:
        size = f"size={DISK_BYTES}"
        subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", name], check=True)
        try:
            yield Path(name)
        finally:
            subprocess.run(["umount", "--lazy", name], check=True)


def _fill(disk: Path) -> None:
    with (disk / "full").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while file.write(bytes(4096)):
            pass


def _empty(disk: Path) -> None:
    (disk / "full").unlink()


def _remount(how: str, disk: Path) -> None:
    subprocess.run(["mount", "-o", f"remount,{how}", str(disk)], check=True)


def disks() -> list[Outcome]:
    """A full disk, then one that can only be read."""
    if not is_root():
        return [Outcome("full disk, read-only disk", "not tried: this needs root")]
    outcomes: list[Outcome] = []
    with ExitStack() as stack:
        disk = stack.enter_context(small_disk())
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        rig = stack.enter_context(Rig(Path(folder), disk / "state"))
        rig.prepare()
        for name, spoil, mend in (
            ("full disk", _fill, _empty),
            ("read-only disk", partial(_remount, "ro"), partial(_remount, "rw")),
        ):
            outcomes += _on_bad_disk(rig, name, partial(spoil, disk), partial(mend, disk))
    return outcomes


def _on_bad_disk(
    rig: Rig, name: str, spoil: Callable[[], None], mend: Callable[[], None]
) -> list[Outcome]:
    driving = Outcome(f"{name}: driving on", "the tour continues")
    saving = Outcome(f"{name}: saving", "refused with the reason; saved data is intact")
    stopping = Outcome(f"{name}: stop", "answered; the robot stops")
    rig.wait_for_driving()
    before = rig.saved()
    spoil()
    restarts = rig.restarts
    time.sleep(DRIVES_S)
    try:
        rig.wait_for_driving()
    except Missing as missing:
        driving.wrong.append(f"{missing} ({describe(rig)})")
    if rig.restarts != restarts:
        driving.wrong.append(f"services ended: {rig.restarts}")
    things: tuple[tuple[Request[Any, Any], object], ...] = (
        (requests.POSES_PUT, SavedPose(name="lost", map="apartment", pose=KITCHEN)),
        (requests.ZONES_PUT, Zone(name="lost", kind="keepout", points=SQUARE)),
    )
    for request, thing in things:
        try:
            rig.ask(request, thing)
            saving.wrong.append(f"{request.name} was answered as if it were saved")
        except Refused as refused:
            if refused.code != codes.NOT_SAVED:
                saving.wrong.append(f"{request.name}: {refused.code}")
    saving.lost = lost(before, rig.saved())
    _stop_and_go_on(rig, stopping)
    killed = [
        disturb(
            rig,
            Fault(
                f"{name}: kill -9 of {one}",
                apply=partial(_kill, one),
                restarts=one,
                **HOW_IT_STANDS[one]._replace(happens="comes back with all its data")._asdict(),
            ),
        )
        for one in ("localizer", "tour", "planner")
    ]
    mend()
    try:
        place = SavedPose(name="found", map="apartment", pose=KITCHEN)
        rig.ask_patiently(requests.POSES_PUT, place)
        rig.ask_patiently(requests.POSES_DELETE, Named(name="found"))
    except Missing as missing:
        saving.wrong.append(f"afterwards: {missing}")
    saving.lost += lost(before, rig.saved())
    return [driving, saving, stopping, *killed]


def _kill(service: str, rig: Rig) -> None:
    rig.signal(service, signal.SIGKILL)


def _stop_and_go_on(rig: Rig, outcome: Outcome) -> None:
    """Press stop while it drives; a person resumes it."""
    try:
        rig.wait_for_driving()
        began_s = time.monotonic()
        rig.ask(requests.BASE_STOP)
        answered_s = time.monotonic() - began_s
        rig.wait(lambda: rig.stood_after(began_s) is not None, 10.0, "the robot stands")
        outcome.stood_s = rig.stood_after(began_s)
        if answered_s > ANSWERED_WITHIN_S + GRAIN_S:
            outcome.wrong.append(f"answered only after {answered_s:.2f} s")
        if outcome.stood_s is not None and outcome.stood_s > COMMAND_LOST_S + GRAIN_S:
            outcome.wrong.append(f"stood only after {outcome.stood_s:.2f} s")
        outcome.happened += f"; answered after {1000 * answered_s:.0f} ms"
        time.sleep(1.0)
        resumed_s = time.monotonic()
        rig.ask_patiently(requests.BASE_RESUME)
        rig.ask_patiently(requests.TOUR_RESUME)
        rig.wait_for_driving()
        outcome.back_s = time.monotonic() - resumed_s
    except (Missing, Refused) as problem:
        outcome.wrong.append(f"{problem} ({describe(rig)})")


# Clocks.
def clocks() -> list[Outcome]:
    """The host's clock jumps by a year, back and forward, under running services and a restart."""
    compiler = shutil.which("cc")
    if compiler is None:
        return [Outcome("clock set by a year", "not tried: there is no C compiler")]
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as name:
        jump, shim = Path(name) / "jump", Path(name) / "clock_shift.so"
        command = [compiler, "-shared", "-fPIC", "-O2", "-o", str(shim), str(CLOCK_SHIFT), "-ldl"]
        subprocess.run(command, check=True)
        _shift(jump, 0)
        environment = {"LD_PRELOAD": str(shim), "CLOCK_SHIFT": str(jump)}
        with Rig(Path(name) / "rig", environment=environment) as rig:
            rig.prepare()
            for seconds, words in ((-YEAR_S, "back by a year"), (YEAR_S, "on by a year")):
                outcomes += _set_clock(rig, partial(_shift, jump, seconds), words)
    return outcomes


def _shift(file: Path, seconds: int) -> None:
    """Set the clocks of the running services: the file is mapped into them."""
    with file.open("r+b" if file.exists() else "w+b") as page:
        page.write(struct.pack("=q", seconds))


def _set_clock(rig: Rig, jump: Callable[[], None], words: str) -> list[Outcome]:
    def now_ns() -> int:
        return rig.connection.robot_now_ns(ROBOT) or 0

    rig.wait_for_driving()
    before_ns = rig.wait(now_ns, 10.0, "robot time")
    jump()
    running = Outcome(f"clock set {words}", "no effect: robot time runs on")
    time.sleep(DRIVES_S)
    passed_s = (rig.wait(now_ns, 10.0, "robot time") - before_ns) * 1e-9
    if not 0.5 * DRIVES_S < passed_s < 4.0 * DRIVES_S:
        running.wrong.append(f"robot time went on by {passed_s:.1f} s in {DRIVES_S:.0f} s")
    try:
        rig.wait_for_driving()
    except Missing as missing:
        running.wrong.append(f"{missing} ({describe(rig)})")
    # Robot time starts again with base, and must not go back.
    kill = Fault(
        f"clock set {words}, then kill -9 of base",
        "robot time does not go back; the trip waits for a person",
        partial(_kill, "base"),
        stands_s=COMMAND_LOST_S,
        asks=True,
        restarts="base",
    )
    last_ns = now_ns()
    restarted = disturb(rig, kill)
    after_ns = rig.wait(now_ns, 10.0, "robot time")
    if after_ns <= last_ns:
        restarted.wrong.append(f"robot time went back by {(last_ns - after_ns) * 1e-9:.1f} s")
    return [running, restarted]


# CPU.
def cpus() -> list[Outcome]:
    """Other programs take all the CPU time."""
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as folder, Rig(Path(folder)) as rig:
        rig.prepare()
        for count, nice in ((4, 0), (8, -5)):
            if nice < 0 and not is_root():
                continue
            outcome = Outcome(f"{count} busy programs at nice {nice}, then a stop", "")
            rig.wait_for_driving()
            before, collisions = rig.saved(), rig.collisions
            with ExitStack() as stack:
                for _ in range(count):
                    busy = subprocess.Popen([sys.executable, "-c", BUSY])
                    stack.callback(busy.wait)
                    stack.callback(busy.kill)
                    os.setpriority(os.PRIO_PROCESS, busy.pid, nice)
                time.sleep(DRIVES_S)
                outcome.happened = "keeps driving as well as it can"
                _stop_and_go_on(rig, outcome)
            outcome.lost = lost(before, rig.saved())
            if rig.collisions > collisions:
                outcome.wrong.append(f"{rig.collisions - collisions} collisions")
            outcomes.append(outcome)
    return outcomes


# Memory.
def _ignore(_: object) -> None:
    """An answer that nobody waits for."""


def _starve(service: str, rig: Rig) -> float:
    """Give a service no more memory than it has."""
    pid = rig.pid(service)
    group = CGROUP / f"trolley-faults-{os.getpid()}-{service}"
    try:
        group.mkdir()
        (group / "memory.limit_in_bytes").write_text(str(1 << 20))
        (group / "cgroup.procs").write_text(str(pid))
    except OSError:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
        limit = pages * resource.getpagesize()
        resource.prlimit(pid, resource.RLIMIT_AS, (limit, limit))

    def has_ended() -> bool:
        # It has enough memory for its work, so it is given something to hold.
        for _ in range(BALLAST_AT_ONCE):
            rig.connection.bus.get(
                BALLAST[service].key(ROBOT), bytes(BALLAST_BYTES), "", 1.0, _ignore, lambda: None
            )
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s and Path(f"/proc/{pid}").exists():
            time.sleep(0.01)
        return not Path(f"/proc/{pid}").exists()

    rig.wait(has_ended, 60.0, f"{service} ends for want of memory")
    ended_s = time.monotonic()
    with contextlib.suppress(OSError):
        group.rmdir()
    return ended_s


def starving() -> list[Fault]:
    """Each service without memory, as `MemoryMax` of its unit does it."""
    return [
        Fault(
            f"{service} out of memory",
            apply=partial(_starve, service),
            restarts=service,
            **how._replace(happens=f"is killed and restarted; {how.happens}")._asdict(),
        )
        for service, how in HOW_IT_STANDS.items()
        if service in BALLAST
    ]
