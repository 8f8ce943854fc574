"""What all lidars do once they stream: bytes become revolutions, and silence is noticed.

Counts, since the last `take`: `lidar/bad_checksum` and `lidar/skipped_bytes` (`frames.py`),
`lidar/short_revolutions` (`revolutions.py`), `lidar/gaps`: so much time was missing between two
frames that samples must have been lost.
"""

from collections import Counter
from collections.abc import Callable

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.messages import Link
from trolley.network_ports import is_network
from trolley_base.drivers.dialogue import BITS_PER_BYTE, Line, Status
from trolley_base.drivers.interface import DriverError, LidarReading, Note
from trolley_base.drivers.lidars.decoding import Decoded, Decoder
from trolley_base.drivers.lidars.models import LidarFacts
from trolley_base.drivers.lidars.revolutions import Revolutions
from trolley_base.drivers.lidars.sample_clock import SampleClock
from trolley_base.units import NS_PER_S

GAPS = "lidar/gaps"
PIECE_BYTES = 4096
"""More bytes are decoded in pieces of this size, so that each call takes a bounded time."""
SILENT_NS = 500_000_000
NO_TURN_NS = 2 * NS_PER_S
"""Frames without a whole revolution for this long are no scan."""
PATIENCE_NS = NS_PER_S
"""No complaint is made for this long after opening."""
REOPEN_NS = 5 * NS_PER_S
ASK_AGAIN_NS = NS_PER_S
"""A silent sensor that has to be started is told so at most this often."""
SPEED_TOLERANCE = 0.02


class StreamingLidar:
    """A lidar that streams by itself; `HandshakeLidar` builds upon it.

    Args:
        config: how it is mounted and what of it counts.
        decoder: makes what decodes it, anew at each opening; it counts what goes wrong.
        drops_speckles: leave dim single echoes out, as `speckles.py` says.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(
        self,
        facts: LidarFacts,
        config: LidarConfig,
        decoder: Callable[[Counter[str]], Decoder],
        *,
        drops_speckles: bool = False,
    ) -> None:
        self.facts = facts
        _check(facts, config)
        self._config = config
        self._make_decoder = decoder
        self._counts: Counter[str] = Counter()
        self._notes: dict[str, Note] = {}
        self._decoder = decoder(self._counts)
        self._drops_speckles = drops_speckles
        self._revolutions = self._none_yet()
        self._clock = SampleClock()
        self._sensor_s = 0.0
        self._reported_hz: float | None = None
        self._begun_ns = self._stream_ns = 0
        self._bytes_ns = self._frame_ns = self._turn_ns = -REOPEN_NS
        self._was_up = False

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self.baud)

    @property
    def baud(self) -> int:
        """Of the line."""
        return self._config.baud or self.facts.baud

    def begin(self, now_ns: int) -> None:
        """The port has been opened: nothing has been heard yet."""
        self._begun_ns = self._stream_ns = now_ns
        self._bytes_ns = self._frame_ns = self._turn_ns = now_ns - REOPEN_NS
        self._was_up = False
        self._restart(self._make_decoder(self._counts))

    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes, the last of which arrived at `arrived_ns`."""
        if data:
            self._bytes_ns = arrived_ns
        for start in range(0, len(data), PIECE_BYTES):
            piece = data[start : start + PIECE_BYTES]
            decoded = self._decoder.decode(piece)
            if decoded is not None:
                behind = len(data) - start - len(piece)
                self._add_samples(decoded, behind, arrived_ns)

    def outgoing(self, now_ns: int) -> bytes:
        """Return nothing: it is not asked."""
        del now_ns
        return b""

    def goodbye(self) -> tuple[bytes, ...]:
        """Return nothing: it cannot be stopped."""
        return ()

    def take(self, now_ns: int) -> LidarReading:
        """Hand over the revolutions completed since the last call."""
        scans = tuple(self._revolutions.scans)
        self._revolutions.scans.clear()
        status = self.status(now_ns)
        if status.state == "up" and status.message:
            self._note("lidar_speed", status.message)
        notes, counts = tuple(self._notes.values()), dict(self._counts)
        self._notes.clear()
        self._counts.clear()
        link = Link(name="lidar", state=status.state, message=status.message)
        return LidarReading(scans, link, notes, counts)

    def status(self, now_ns: int) -> Status:
        """Say how it goes; `up` with a message is a lidar that turns at a wrong speed."""
        if not self.is_silent(now_ns, SILENT_NS) and now_ns - self._turn_ns <= NO_TURN_NS:
            return Status("up", self._speed_trouble())
        state = "down" if self._was_up else "searching"
        heard_ns = max(self._frame_ns, self._begun_ns)
        return Status(state, self._trouble(now_ns), reopen=now_ns - heard_ns >= REOPEN_NS)

    def is_silent(self, now_ns: int, longer_ns: int) -> bool:
        """Say whether the last good frame is longer ago than this."""
        return now_ns - self._frame_ns > longer_ns

    def _none_yet(self) -> Revolutions:
        config, drops = self._config, self._drops_speckles
        return Revolutions(self.facts, config, self._counts, drops_speckles=drops)

    def _restart(self, decoder: Decoder) -> None:
        """Begin to listen to a stream, with the clock and the revolution forgotten."""
        finished = self._revolutions.scans
        self._revolutions = self._none_yet()
        self._revolutions.scans.extend(finished)
        self._decoder, self._clock, self._sensor_s = decoder, SampleClock(), 0.0

    def _add_samples(self, decoded: Decoded, behind: int, arrived_ns: int) -> None:
        sensor_s = self._sensor_s + np.cumsum(decoded.samples.elapsed_s)
        self._sensor_s = float(sensor_s[-1])
        byte_ns = BITS_PER_BYTE * NS_PER_S / self.baud
        if self.facts.has_usb or is_network(self._config.port):
            byte_ns = 0.0
        measured_s = sensor_s[decoded.closing] + decoded.ahead_s
        leads_ns = -(decoded.behind + behind) * byte_ns - measured_s * NS_PER_S
        if not self._clock.update(self._sensor_s, arrived_ns + round(float(leads_ns.min()))):
            self._counts[GAPS] += 1
            self._revolutions.abandon()
        finished = self._revolutions.finished
        self._revolutions.add(decoded.samples, sensor_s, self._clock)
        self._frame_ns = arrived_ns
        self._reported_hz = decoded.turns_hz
        if self._revolutions.finished != finished:
            self._turn_ns, self._was_up = arrived_ns, True

    def _note(self, kind: str, text: str) -> None:
        self._notes[kind] = Note("warning", kind, text)

    def _trouble(self, now_ns: int) -> str:
        """Say why there is no scan, and what to do about it."""
        facts = self.facts
        if not self.is_silent(now_ns, SILENT_NS):
            if now_ns - max(self._turn_ns, self._stream_ns) <= NO_TURN_NS:
                return f"The {facts.title} is starting to turn."
            if self._revolutions.short_in_a_row:
                return (
                    f"Much of what the {facts.title} sends is lost or damaged: is its cable loose, "
                    f"too long or beside a motor's?"
                )
            return self._speed_trouble() or (
                f"The {facts.title} sends, but its head does not turn. {facts.speed_hint}"
            )
        if not self._was_up and now_ns - self._begun_ns < PATIENCE_NS:
            return f"Waiting for the {facts.title}."
        if now_ns - self._bytes_ns <= SILENT_NS:
            return f"What arrives is not what the {facts.title} sends: wrong model or baud rate?"
        if self._was_up:
            return (
                f"The {facts.title} has gone silent: check power and cable. {self._speed_trouble()}"
            ).rstrip()
        return (
            f"No answer from the {facts.title}: check power and cable "
            f"(a weak 5 V supply is the usual cause)."
        )

    def _speed_trouble(self) -> str:
        """Say that it turns at a wrong speed; "" if it does not."""
        hz = self._revolutions.turns_hz if self._reported_hz is None else self._reported_hz
        low, high = self.facts.turns_hz
        if hz is None or low * (1.0 - SPEED_TOLERANCE) <= hz <= high * (1.0 + SPEED_TOLERANCE):
            return ""
        return (
            f"The {self.facts.title} turns at {60.0 * hz:.0f} rpm instead of {60.0 * low:.0f} to "
            f"{60.0 * high:.0f}. {self.facts.speed_hint}"
        )


class StartedLidar(StreamingLidar):
    """A lidar that streams once it is told to, and does not answer that.

    Args:
        config: how it is mounted and what of it counts.
        decoder: makes what decodes it.
        start: makes it stream.
        stop: ends that.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(
        self,
        facts: LidarFacts,
        config: LidarConfig,
        decoder: Callable[[Counter[str]], Decoder],
        start: bytes,
        stop: bytes,
    ) -> None:
        super().__init__(facts, config, decoder)
        self._start, self._stop = start, stop
        self._asked_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        """The port has been opened: start the sensor."""
        super().begin(now_ns)
        self._asked_ns = None

    def outgoing(self, now_ns: int) -> bytes:
        """Ask it to start, over and over while it is silent."""
        is_patient = self._asked_ns is not None and now_ns - self._asked_ns < ASK_AGAIN_NS
        if is_patient or not self.is_silent(now_ns, ASK_AGAIN_NS if self._asked_ns else 0):
            return b""
        self._asked_ns = now_ns
        return self._start

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the sensor."""
        return (self._stop,)


def _check(facts: LidarFacts, config: LidarConfig) -> None:
    """Refuse what this model cannot do."""
    near = config.range_min_m or facts.range_min_m
    far = config.range_max_m or facts.range_max_m
    if near >= far:
        raise DriverError(
            f"[base.lidar] leaves nothing to see: the {facts.title} would count from "
            f"{near:g} m to {far:g} m; change range_min_m or range_max_m"
        )
    if config.mode not in facts.modes:
        raise DriverError(
            f'[base.lidar] the {facts.title} has no mode "{config.mode}"; remove the line'
        )
