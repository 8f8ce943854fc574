"""Small strict motor boards, written from the protocols alone, and a line in simulated time.

They fail where a real board would be harmed: an id that was not announced, a frame or an argument
that is too long.
"""

import math
import struct
from collections.abc import Callable
from typing import Any

from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley_base.drivers import ChassisReading
from trolley_base.drivers.dialogue import BoardDialogue

MS = 1_000_000
MD5 = {
    "lino_msgs/Velocities": "0ee8ad4cb7809be2d5a0a76352fea86a",
    "lino_msgs/Imu": "275110405f08e1b7c0c0f1aba3e19c67",
    "lino_msgs/PID": "a559df187bdf63f426d5f304b6b28bb4",
    "geometry_msgs/Twist": "9f195f881246fdfa2798d1d3eebca84a",
}


def slow_frames(stream: bytes) -> list[tuple[int, bytes]]:
    """All rosserial frames of a whole stream, looked for byte by byte."""
    frames: list[tuple[int, bytes]] = []
    at = 0
    while len(stream) - at >= 5:
        sync, version, low, high, check = stream[at : at + 5]
        length = low + 256 * high
        if sync != 0xFF or version != 0xFE or length > 512 or (low + high + check) % 256 != 255:
            at += 1
            continue
        if len(stream) - at < 8 + length:
            break
        body = stream[at + 5 : at + 8 + length]
        if sum(body) % 256 == 255:
            frames.append((body[0] + 256 * body[1], body[2:-1]))
            at += 8 + length
        else:
            at += 1
    return frames


def frame(topic_id: int, payload: bytes = b"") -> bytes:
    """One rosserial frame."""
    size, ident = len(payload).to_bytes(2, "little"), topic_id.to_bytes(2, "little")
    check = bytes([255 - sum(size) % 256])
    return b"\xff\xfe" + size + check + ident + payload + bytes([255 - sum(ident + payload) % 256])


def text(value: str) -> bytes:
    """A string of a ROS message."""
    return len(value.encode()).to_bytes(4, "little") + value.encode()


def topic_info(topic_id: int, name: str, kind: str, md5: str | None = None) -> bytes:
    """The payload of an announcement."""
    md5 = MD5[kind] if md5 is None else md5
    return (
        struct.pack("<H", topic_id) + text(name) + text(kind) + text(md5) + struct.pack("<i", 512)
    )


class FakeLinorobot:
    """linorobot's firmware: silent until it is asked, 20 Hz, a watchdog of 0.4 s."""

    def __init__(self) -> None:
        self.publishes = {
            125: ("raw_vel", "lino_msgs/Velocities"),
            126: ("raw_imu", "lino_msgs/Imu"),
        }
        self.subscribes = {100: ("pid", "lino_msgs/PID"), 101: ("cmd_vel", "geometry_msgs/Twist")}
        self.wrong_md5: dict[str, str] = {}
        self.logs: list[tuple[int, str]] = []
        self.imu = (0.1, 0.2, 9.8, 0.01, 0.02, 0.3)
        self.commands: list[tuple[int, Twist2D]] = []
        self.gains: list[tuple[float, float, float]] = []
        self.requests: list[int] = []
        self.times: list[tuple[int, int]] = []
        self.stops = 0
        self.watchdog_trips = 0
        self.pose = Pose2D.identity()
        self.reboot()

    def reboot(self) -> None:
        self.is_configured = False
        self.twist = Twist2D.zero()
        self._way: list[Twist2D] = []
        self._command_ns: int | None = None
        self._vel_ns = self._sync_ns = self._now_ns = self._log_ns = 0
        self._bytes = b""
        self._out = b""

    def receive(self, data: bytes, now_ns: int) -> None:
        for topic_id, payload in slow_frames(data):
            self._take(topic_id, payload, now_ns)
        assert sum(len(payload) + 8 for _, payload in slow_frames(data)) == len(data)

    def _take(self, topic_id: int, payload: bytes, now_ns: int) -> None:
        if topic_id == 0:
            self.requests.append(now_ns)
            self._announce(now_ns)
        elif topic_id == 10:
            self.times.append(struct.unpack("<II", payload))
        elif topic_id == 11:
            self.is_configured = False
            self.stops += 1
        else:
            assert topic_id in self.subscribes, f"{topic_id} was not announced"
            name, _ = self.subscribes[topic_id]
            if name == "pid":
                self.gains.append(struct.unpack("<3f", payload))
            elif name == "cmd_vel":
                vx, vy, _, _, _, wz = struct.unpack("<6d", payload)
                self.twist, self._command_ns = Twist2D(vx, vy, wz), now_ns
                self.commands.append((now_ns, self.twist))

    def _announce(self, now_ns: int) -> None:
        self._out += frame(10, bytes(8))
        for topics, on in ((self.publishes, 0), (self.subscribes, 1)):
            for topic_id, (name, kind) in topics.items():
                md5 = self.wrong_md5.get(name)
                self._out += frame(on, topic_info(topic_id, name, kind, md5))
        self.is_configured, self._sync_ns = True, now_ns
        self._vel_ns = now_ns

    def step(self, now_ns: int) -> bytes:
        """Live up to now; return what was sent."""
        while self._now_ns < now_ns:
            self._now_ns += MS
            if self._command_ns is not None and self._now_ns - self._command_ns >= 400 * MS:
                self.watchdog_trips += not self.twist.is_zero
                self.twist = Twist2D.zero()
            self.pose = integrate_twist(self.pose, self.twist, 1e-3)
            self._way.append(self.twist)
            if self.is_configured:
                self._publish()
        sent, self._out = self._out, b""
        return sent

    def _publish(self) -> None:
        now_ns = self._now_ns
        if now_ns - self._vel_ns >= 50 * MS:
            self._vel_ns = now_ns
            count = len(self._way)
            mean = [sum(getattr(t, part) for t in self._way) / count for part in ("vx", "vy", "wz")]
            self._way.clear()
            self._say("raw_vel", struct.pack("<3f", *mean))
            self._say("raw_imu", struct.pack("<9d", *self.imu, 0.0, 0.0, 0.0))
        if now_ns - self._log_ns >= 50 * MS:
            self._log_ns = now_ns
            for level, line in self.logs:
                self._out += frame(7, bytes([level]) + text(line.format(now_ns)))
        if now_ns - self._sync_ns >= 2500 * MS:
            self._sync_ns = now_ns
            self._out += frame(10, bytes(8))

    def _say(self, name: str, payload: bytes) -> None:
        for topic_id, (known, _) in self.publishes.items():
            if known == name:
                self._out += frame(topic_id, payload)


class FakeArduino:
    """ROSArduinoBridge: one line, one answer; 33 ms frames; stops by itself after 2 s."""

    def __init__(self, *, has_base: bool = True) -> None:
        self.has_base = has_base
        self.pins: dict[str, int] = {}
        self.lines: list[tuple[int, str]] = []
        self.gains = ""
        self.auto_stops = 0
        self.is_deaf = False
        self.counts = [0.0, 0.0]
        self.answer_ns = 3 * MS
        self.reboot()

    def reboot(self) -> None:
        self.counts = [0.0, 0.0]
        self.targets = [0, 0]
        self.gains = ""
        self._bytes = b""
        self._out: list[tuple[int, bytes]] = []
        self._now_ns = self._motor_ns = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        if self.is_deaf:
            return
        assert len(data) <= 64, "the board's buffer overflows"
        *lines, self._bytes = (self._bytes + data).split(b"\r")
        for line in lines:
            self._out.append((now_ns + self.answer_ns, self._answer(line.decode(), now_ns)))

    def _answer(self, line: str, now_ns: int) -> bytes:
        self.lines.append((now_ns, line))
        command, *arguments = line.split(" ")
        assert all(len(argument) <= 15 for argument in arguments), line
        if command == "b":
            return b" 57600\r\n"
        if command in ("d", "a", "p"):
            return b"%d\r\n" % self.pins.get(line, 1)
        if not self.has_base:
            return b"Invalid Command\r\n"
        if command == "e":
            wrapped = [(math.floor(count) + 2**31) % 2**32 - 2**31 for count in self.counts]
            return b"%d %d\r\n" % tuple(wrapped)
        if command == "m":
            self.targets = [int(argument) for argument in arguments]
            assert all(abs(target) < 2**15 for target in self.targets)
            self._motor_ns = now_ns
        elif command == "u":
            self.gains = arguments[0]
        else:
            raise AssertionError(line)
        return b"OK\r\n"

    def step(self, now_ns: int) -> bytes:
        """Live up to now; return what was sent."""
        while self._now_ns < now_ns:
            self._now_ns += MS
            if self._now_ns - self._motor_ns > 2000 * MS:
                self.auto_stops += self.targets != [0, 0]
                self.targets = [0, 0]
            for side in (0, 1):
                self.counts[side] += self.targets[side] / 33.0
        ready = [data for at_ns, data in self._out if at_ns <= now_ns]
        self._out = [item for item in self._out if item[0] > now_ns]
        return b"" if self.is_deaf else b"".join(ready)


class Talk:
    """A dialogue and a board on one line, in steps of 20 ms of simulated time.

    `spoil` may change what the board sent on its way to the host; `wanted` is driven all the time.
    """

    def __init__(self, dialogue: BoardDialogue, board: Any, start_ns: int = 10**18) -> None:
        self.dialogue, self.board = dialogue, board
        self.start_ns = self.now_ns = start_ns
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self.wanted = Twist2D.zero()
        self.sent: list[tuple[int, bytes]] = []
        self.readings: list[ChassisReading] = []
        self.pose = Pose2D.identity()
        dialogue.begin(start_ns)

    def tick(self) -> ChassisReading:
        self.now_ns += 20 * MS
        data = self.spoil(self.board.step(self.now_ns - self.start_ns))
        if data:
            self.dialogue.receive(data, self.now_ns)
        reading = self.dialogue.take(self.now_ns)
        self.readings.append(reading)
        for motion in reading.motions:
            self.pose = self.pose @ motion.previous_T_base
        self.dialogue.drive(self.wanted)
        out = self.dialogue.outgoing(self.now_ns)
        if out:
            self.sent.append((self.now_ns, out))
            self.board.receive(out, self.now_ns - self.start_ns)
        return reading

    def run(self, seconds: float) -> ChassisReading:
        for _ in range(round(seconds * 50)):
            self.tick()
        return self.readings[-1]

    def total(self, name: str) -> int:
        return sum(reading.counts.get(f"chassis/{name}", 0) for reading in self.readings)
