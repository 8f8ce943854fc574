"""A base without a line of Trolley, as firmware would be: to read and to copy from, not to drive.

It speaks the wire with nothing but Zenoh and a little msgpack, written out below:

    trolley router
    python examples/bare_base.py mine tcp/127.0.0.1:7447

With localizer, planner and tour beside it, it drives in an imaginary room, that of worlds/room.yaml
without its furniture, from [start] pose = { x = -2.2, y = -1.8, yaw = 0.0 }. It ends commands in
time and latches a stop while it runs. It has no stop field and keeps nothing over a restart, which
docs/own-base.md asks for.
"""

# Zenoh's stubs leave most of its results without a type.

import itertools
import math
import queue
import struct
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

PRIORITIES = {"teleop": 20, "planner": 10}
SPEED, TURN = 0.4, 1.5
"""Limits [m/s], [rad/s]."""
WALLS = -3.0, -2.5, 3.0, 2.5
"""Of the room: smallest x and y, largest x and y [m]."""
START = -2.2, -1.8
"""Where it begins there, looking along x [m]."""
STREAMS = "clock", "robot", "tf/laser", "scan", "odom", "cmd_vel", "base", "health/base"
OUTLINE = [[0.15, 0.0], [0.07, 0.13], [-0.07, 0.13], [-0.15, 0.0], [-0.07, -0.13], [0.07, -0.13]]


def pack(value: Any) -> bytes:
    """Return msgpack, as far as it is needed: floats have 4 bytes, integers 8."""
    match value:
        case dict():
            items = b"".join(pack(key) + pack(one) for key, one in value.items())
            return bytes([0x80 | len(value)]) + items
        case list():
            return bytes([0x90 | len(value)]) + b"".join(map(pack, value))
        case str():
            return bytes([0xD9, len(value)]) + value.encode()
        case bytes():
            return b"\xc5" + struct.pack(">H", len(value)) + value
        case float():
            return b"\xca" + struct.pack(">f", value)
        case int():
            return b"\xd3" + struct.pack(">q", value)
        case _:
            raise TypeError(value)


NUMBERS = {
    0xCA: ">f",
    0xCB: ">d",
    0xCC: ">B",
    0xCD: ">H",
    0xCE: ">I",
    0xCF: ">Q",
    0xD0: ">b",
    0xD1: ">h",
    0xD2: ">i",
    0xD3: ">q",
}


def unpack(data: bytes, at: int = 0) -> tuple[Any, int]:
    """Return a value and where it ends: maps, short strings and numbers, as commands have them."""
    kind = data[at]
    at += 1
    if kind < 0x80:
        return kind, at
    if kind < 0x90:
        found: dict[str, Any] = {}
        for _ in range(kind & 0x0F):
            key, at = unpack(data, at)
            found[key], at = unpack(data, at)
        return found, at
    if 0xA0 <= kind < 0xC0:
        end = at + (kind & 0x1F)
        return data[at:end].decode(), end
    if kind >= 0xE0:
        return kind - 0x100, at
    return struct.unpack_from(NUMBERS[kind], data, at)[0], at + struct.calcsize(NUMBERS[kind])


class Command(NamedTuple):
    """What is needed of a velocity command."""

    stamp_ns: int
    valid_s: float
    vx: float
    wz: float


def read_command(payload: bytes) -> Command | None:
    """Return what a payload says, None if it is no command: anybody may send anything."""
    try:
        message, _ = unpack(payload)
        twist = message["twist"]
        command = Command(message["stamp_ns"], message["valid_for"], twist["vx"], twist["wz"])
        is_sound = isinstance(command.stamp_ns, int) and all(map(math.isfinite, command))
    except (IndexError, KeyError, TypeError, ValueError, RecursionError, struct.error):
        return None
    return command if is_sound else None


class Wire:
    """Keys of one robot: what is put is kept for whoever asks later."""

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        self._session = session
        self._root = f"trolley/{robot}/"
        self._latest: dict[str, bytes] = {}

    def put(self, stream: str, /, **message: Any) -> None:
        """Publish a message."""
        payload = self._latest[stream] = pack(message)
        self._session.put(self._root + stream, payload)

    def serve(self, name: str, act: Callable[[], None] = lambda: None, reply: str = "") -> None:
        """Answer a `get`, after `act`, with the latest message of the stream `reply`."""

        def answer(query: zenoh.Query) -> None:
            with query:
                act()
                if (reply or name) in self._latest:
                    query.reply(self._root + name, self._latest[reply or name])

        self._session.declare_queryable(self._root + name, answer)

    def hear(self, name: str, then: Callable[[str, bytes], None]) -> None:
        """Call back with the last chunk of the key, and the payload."""

        def take(sample: zenoh.Sample) -> None:
            then(str(sample.key_expr).rpartition("/")[2], sample.payload.to_bytes())

        self._session.declare_subscriber(self._root + name, take)


class Base:
    """Robot time, wheels, lidar, and what may move them."""

    def __init__(self, wire: Wire, robot: str, run: str) -> None:
        self._wire, self._robot, self._run = wire, robot, run
        self._epoch_ns, self._began_ns = time.time_ns(), time.monotonic_ns()
        self._arrived: queue.SimpleQueue[tuple[str, bytes, int]] = queue.SimpleQueue()
        self._commands: dict[str, tuple[Command, int]] = {}
        """Of each source the newest, and until when it holds."""
        self._is_stopped = False
        self._driver = ""
        self._x, self._y, self._yaw = *START, 0.0
        self._v = self._w = 0.0
        self._now_ns = self._time()

    def begin(self) -> None:
        """Say who this is; answer and listen from now on."""
        wire = self._wire
        for name in STREAMS:
            wire.serve(name)
        wire.serve("@do/base/stop", lambda: self._switch(is_stopped=True), "base")
        wire.serve("@do/base/resume", lambda: self._switch(is_stopped=False), "base")
        wire.hear("cmd_vel/*", lambda *command: self._arrived.put((*command, self._time())))  # pyrefly: ignore[bad-argument-type]
        self._tell_time()
        wire.put(
            "robot",
            stamp_ns=self._time(),
            name=self._robot,
            title="Bare",
            footprint=OUTLINE,
            drive="differential",
            max_speed=SPEED,
            max_wz=TURN,
            deceleration=1.0,
        )
        ahead = {"x": 0.0, "y": 0.0, "yaw": 0.0}
        link = {"parent": "base_link", "child": "laser", "pose": ahead, "z": 0.2}
        wire.put("tf/laser", stamp_ns=self._time(), **link)
        self._tell_state()

    def step(self, number: int) -> None:
        """Do what is due every 20 ms."""
        now_ns, before_ns = self._time(), self._now_ns
        self._now_ns = now_ns
        self._move((now_ns - before_ns) * 1e-9)
        self._drive(now_ns)
        pose = {
            "x": self._x - START[0],
            "y": self._y - START[1],
            "yaw": math.remainder(self._yaw, 2.0 * math.pi),
        }
        twist = {"vx": self._v, "vy": 0.0, "wz": self._w}
        self._wire.put("odom", stamp_ns=now_ns, pose=pose, twist=twist)
        if number % 5 == 0:
            self._tell_time()
            self._look(now_ns)
            self._wire.put("cmd_vel", stamp_ns=now_ns, twist=twist, valid_for=0.1)
        if number % 50 == 0:
            self._tell_state()
            self._wire.put("health/base", stamp_ns=now_ns, state="ok", run=self._run)

    def _time(self) -> int:
        return self._epoch_ns + time.monotonic_ns() - self._began_ns

    def _tell_time(self) -> None:
        self._wire.put("clock", stamp_ns=self._time(), rate=1.0, epoch=self._epoch_ns)

    def _tell_state(self) -> None:
        state: dict[str, Any] = {"mode": "ok", "reason": ""}
        if self._is_stopped:
            state = {"mode": "stopped", "reason": "button"}
        if self._driver:
            state["source"] = self._driver
        self._wire.put("base", stamp_ns=self._time(), **state)

    def _switch(self, *, is_stopped: bool) -> None:
        """Stop or resume, on a thread of Zenoh's; the next step heeds it."""
        self._is_stopped = is_stopped
        self._tell_state()

    def _take(self, source: str, payload: bytes, arrived_ns: int) -> None:
        command, last = read_command(payload), self._commands.get(source)
        if command is None or source not in PRIORITIES:
            return
        is_timely = -200_000_000 <= arrived_ns - command.stamp_ns <= 500_000_000
        if is_timely and (last is None or command.stamp_ns > last[0].stamp_ns):
            until_ns = arrived_ns + round(min(command.valid_s, 0.5) * 1e9)
            self._commands[source] = command, until_ns

    def _drive(self, now_ns: int) -> None:
        """Take what has arrived; drive by the highest source that holds, else stand."""
        while not self._arrived.empty():
            self._take(*self._arrived.get())
        if self._is_stopped:
            self._commands = {one: (command, 0) for one, (command, _) in self._commands.items()}
        holding = [one for one, (_, until_ns) in self._commands.items() if now_ns < until_ns]
        self._v = self._w = 0.0
        self._driver = max(holding, key=PRIORITIES.__getitem__, default="")
        if self._driver:
            command, _ = self._commands[self._driver]
            self._v = max(-SPEED, min(SPEED, float(command.vx)))
            self._w = max(-TURN, min(TURN, float(command.wz)))

    def _move(self, seconds: float) -> None:
        """Imagine that the wheels turn."""
        heading = self._yaw + 0.5 * self._w * seconds
        self._x += self._v * math.cos(heading) * seconds
        self._y += self._v * math.sin(heading) * seconds
        self._yaw += self._w * seconds

    def _look(self, now_ns: int) -> None:
        """Imagine a lidar with a beam at each degree."""
        ranges = [self._range(self._yaw + math.radians(degree)) for degree in range(360)]
        self._wire.put(
            "scan",
            stamp_ns=now_ns,
            frame="laser",
            angle_min=0.0,
            angle_increment=math.radians(1.0),
            time_increment=0.0,
            range_min=0.05,
            range_max=8.0,
            ranges=struct.pack("<360f", *ranges),
        )

    def _range(self, angle: float) -> float:
        across, along = math.cos(angle), math.sin(angle)
        x = WALLS[2] - self._x if across > 0.0 else WALLS[0] - self._x
        y = WALLS[3] - self._y if along > 0.0 else WALLS[1] - self._y
        return min(x / across if across else math.inf, y / along if along else math.inf)


def main(robot: str, endpoint: str) -> None:
    """Be the base of `robot` until somebody ends it."""
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", f'["{endpoint}"]')
    run = f"board-1-{time.time_ns() // 1_000_000}"
    alive = f"trolley/{robot}/alive/base/{run}"
    with zenoh.open(settings) as session, session.liveliness().declare_token(alive):
        base = Base(Wire(session, robot), robot, run)
        base.begin()
        for number in itertools.count():
            time.sleep(0.02)
            base.step(number)


if __name__ == "__main__":
    main(*sys.argv[1:3])
