"""Lidars of the Slamtec kind: A5 and a command; the answer begins with A5 5A and what it is.

A handshake is a script: a generator that yields what to send and what to wait for, and is handed
the answer, or None when none came in time. When it returns, the lidar streams; when a stream falls
silent, the handshake begins again.

Sources:
    SLAMTEC rplidar_sdk (`sl_lidar_protocol.h`); YDLIDAR X4 development manual.
"""

from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.lidars.decoding import Decoder
from trolley_base.drivers.lidars.models import LidarFacts
from trolley_base.drivers.lidars.streaming import StreamingLidar
from trolley_base.units import NS_PER_S

INFO = bytes.fromhex("A55A 1400 0000 04")
HEALTH = bytes.fromhex("A55A 0300 0000 06")
INFO_BYTES, HEALTH_BYTES = 20, 3
ANSWER_S = 0.5
SILENT_NS = 2 * NS_PER_S
MOST_HELD = 8192
"""What may come before an answer: the rest of a stream that has just been stopped."""


@dataclass(frozen=True, slots=True)
class Step:
    """What a script does next.

    Attributes:
        send: bytes, b"" for nothing.
        wait_s: how long to wait for the answer, or just so.
        answer: how the answer begins; b"": none is expected, and what comes is dropped.
        body_bytes: how many bytes follow that beginning.
        end: what ends an answer of no fixed length, which is handed over without it.
    """

    send: bytes
    wait_s: float
    answer: bytes = b""
    body_bytes: int = 0
    end: bytes = b""


Handshake = Generator[Step, bytes | None, None]


class HandshakeLidar(StreamingLidar):
    """A lidar that streams after a handshake; subclasses write the script.

    Args:
        config: how it is mounted and what of it counts.
        decoder: makes what decodes its stream.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(
        self, facts: LidarFacts, config: LidarConfig, decoder: Callable[[Counter[str]], Decoder]
    ) -> None:
        super().__init__(facts, config, decoder)
        self._fault = ""
        """What the lidar says is wrong with it."""
        self._has_answered = False
        self._script = self._handshake()
        self._step: Step | None = next(self._script)
        self._deadline_ns: int | None = None
        self._held = bytearray()

    def begin(self, now_ns: int) -> None:
        """The port has been opened: begin the handshake."""
        super().begin(now_ns)
        self._start_handshake()

    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes, the last of which arrived at `arrived_ns`."""
        if self._step is None:
            super().receive(data, arrived_ns)
            return
        self._bytes_ns = arrived_ns
        if not self._step.answer or self._deadline_ns is None:
            return
        self._held += data
        start = self._held.find(self._step.answer)
        body = start + len(self._step.answer)
        end = body + self._step.body_bytes
        if start >= 0 and self._step.end:
            end = self._held.find(self._step.end, body)
        if start < 0 or not body <= end <= len(self._held):
            del self._held[:-MOST_HELD]
            return
        rest = bytes(self._held[end + len(self._step.end) :])
        self._has_answered = True
        if self._advance(bytes(self._held[body:end])):
            self._frame_ns = self._stream_ns = arrived_ns  # it has said that it begins
            super().receive(rest, arrived_ns)

    def outgoing(self, now_ns: int) -> bytes:
        """Return what the script says next."""
        if self._step is None and self.is_silent(now_ns, SILENT_NS):
            self._start_handshake()
        if self._deadline_ns is not None and now_ns >= self._deadline_ns:
            self._advance(None)
        if self._step is None or self._deadline_ns is not None:
            return b""
        self._deadline_ns = now_ns + round(self._step.wait_s * NS_PER_S)
        self._held.clear()
        return self._step.send

    def _handshake(self) -> Handshake:
        """Return the script."""
        raise NotImplementedError

    def _start_handshake(self) -> None:
        self._script.close()
        self._has_answered = False
        self._script = self._handshake()
        self._step, self._deadline_ns = next(self._script), None

    def _advance(self, answer: bytes | None) -> bool:
        """Go on with the script; True where that was its end."""
        was_asked = self._step is not None and bool(self._step.answer)
        if was_asked and answer is None and not self._has_answered:
            self._fault = ""  # it said so before its power was cut
        try:
            self._step = self._script.send(answer)
        except StopIteration:
            self._step = None
        self._deadline_ns = None
        return self._step is None

    def _trouble(self, now_ns: int) -> str:
        if self._fault:
            return self._fault
        if self._step is not None and self._has_answered:
            return f"The {self.facts.title} answers and is being started."
        return super()._trouble(now_ns)

    def _ask_who(
        self, get_info: bytes, get_health: bytes, is_model: Callable[[int], bool]
    ) -> Generator[Step, bytes | None, tuple[bytes, bool] | None]:
        """Ask who it is and how it is; its information, and whether it is well.

        Args:
            get_info: the one question.
            get_health: the other.
            is_model: whether a model number is the expected one.

        Returns:
            None where one of the two is not answered.
        """
        info = yield Step(get_info, ANSWER_S, INFO, INFO_BYTES)
        if info is None:
            return None
        self._check_model(is_model(info[0]), info[0])
        health = yield Step(get_health, ANSWER_S, HEALTH, HEALTH_BYTES)
        return None if health is None else (info, self._check_health(health))

    def _check_health(self, health: bytes) -> bool:
        """Take an answer to "how are you"; False where the lidar says that it is faulty."""
        status, code = health[0], int.from_bytes(health[1:3], "little")
        self._fault = ""
        if status == 0:
            return True
        if status == 1:
            self._note("lidar_health", f"The {self.facts.title} warns: health code {code}.")
            return True
        self._fault = (
            f"The {self.facts.title} reports a fault (health error {code}): unplug its power for "
            "a few seconds; is its head free to turn, and its 5 V supply strong enough?"
        )
        return False

    def _check_model(self, is_expected: bool, model: int) -> None:
        """Warn of a lidar that says it is another one."""
        if not is_expected:
            self._note(
                "lidar_model",
                f"This lidar says it is model 0x{model:02X}, not a {self.facts.title}; "
                f"its scans may be wrong.",
            )
