"""A dialogue held over a port: what arrives goes in, what it wants to say goes out."""

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, TypeVar

from trolley.messages import Link
from trolley_base.drivers.dialogue import Dialogue
from trolley_base.drivers.serial_device import Arrived, Event, Lost, Opened, SerialDevice

D = TypeVar("D", bound=Dialogue)

REOPEN_EVERY_NS = 5_000_000_000
"""A port is opened again at most this often at a dialogue's request [ns]."""
REFUSED_NS = 500_000_000
"""A port that has refused all writes for this long is reopened [ns]."""
TAKEN_NS = 1_000_000_000
"""Time without a refused write after which a port counts as up again [ns]."""
MOST_LOSSES, LOSSES_WITHIN_NS = 3, 10_000_000_000
"""A device that was lost this often within this time [ns] is not used for now."""
STEADY_NS = 3_000_000_000
"""Time of connection after which a device that was lost too often is used again [ns]."""


class SerialLink(Generic[D]):
    """Ties a dialogue to its device; used by the service's thread only.

    Args:
        name: of the link: `chassis` or `lidar`.
        dialogue: the state machine.
        device: the port; started by the caller.
        robot_ns: turns local monotonic time into robot time [ns].
        is_stream: bytes that came since the last call are handed over together, as if all had come
            with the last: a lidar's clock takes the least lateness, and each call costs much.
    """

    def __init__(
        self,
        name: str,
        dialogue: D,
        device: SerialDevice,
        robot_ns: Callable[[int], int],
        *,
        is_stream: bool = False,
    ) -> None:
        self.dialogue = dialogue
        self._name = name
        self._device = device
        self._robot_ns = robot_ns
        self._is_stream = is_stream
        self._is_open = False
        self.is_gone = False
        """Whether the port has gone or cannot be opened, which is no matter of time."""
        self._trouble = ""
        self._reopen_after_ns = 0
        self._refused_writes = 0
        self._refused_since_ns: int | None = None
        self._refused_ns = 0
        self._was_up = False
        self._up_since_ns = 0
        self._losses_ns: list[int] = []

    def listen(self, now_ns: int) -> None:
        """Hand over what has arrived."""
        events = self._device.take()
        for event in joined(events) if self._is_stream else events:
            match event:
                case Arrived(data, monotonic_ns):
                    self.dialogue.receive(data, min(now_ns, self._robot_ns(monotonic_ns)))
                case Opened():
                    self._is_open, self.is_gone, self._trouble = True, False, ""
                    self._refused_since_ns = None
                    self._reopen_after_ns = now_ns + REOPEN_EVERY_NS
                    self.dialogue.begin(now_ns)
                case Lost(why):
                    self._is_open, self.is_gone, self._trouble = False, True, why

    def speak(self, now_ns: int) -> None:
        """Send what the dialogue has to say."""
        if not self._is_open:
            return
        data = self.dialogue.outgoing(now_ns)
        if data:
            self._note_write(now_ns, is_taken=self._device.write(data))
        if not self._is_open:
            return
        if now_ns >= self._reopen_after_ns and self.dialogue.status(now_ns).reopen:
            self._reopen(now_ns, self.link(now_ns).message)

    def _note_write(self, now_ns: int, *, is_taken: bool) -> None:
        """Open a port anew that takes nothing: what is commanded does not reach the device."""
        if is_taken:
            # What was refused has been thrown away, so there is room for a moment.
            if now_ns - self._refused_ns >= TAKEN_NS:
                self._refused_since_ns = None
            return
        self._refused_writes += 1
        self._refused_ns = now_ns
        if self._refused_since_ns is None:
            self._refused_since_ns = now_ns
        elif now_ns - self._refused_since_ns >= REFUSED_NS:
            self._refused_since_ns = None
            self._reopen(now_ns, self._takes_nothing)

    @property
    def _takes_nothing(self) -> str:
        return (
            f"{self._device.path} accepts nothing that is written to it: the device or its "
            "adapter hangs; unplug it and plug it in again."
        )

    def restart(self, now_ns: int) -> bool:
        """Reopen the port where that restarts the device; False where it would not."""
        if not (self._is_open and self.dialogue.line.restarts):
            return False
        self._reopen(now_ns, "The motor board is being restarted.")
        return True

    def _reopen(self, now_ns: int, why: str) -> None:
        self._reopen_after_ns = now_ns + REOPEN_EVERY_NS
        self._trouble, self._is_open = why, False
        self._device.reopen()

    def link(self, now_ns: int) -> Link:
        """Say how the connection is, naming the port; one that comes and goes is down."""
        link = self._present_link(now_ns)
        self._note_losses(now_ns, is_up=link.state == "up")
        if link.state != "up" or len(self._losses_ns) < MOST_LOSSES:
            return link
        message = (
            f"{self._device.path}: the connection was lost {len(self._losses_ns)} times within "
            f"{LOSSES_WITHIN_NS // 1_000_000_000} s: the device restarts, or its cable is loose. "
            "Check its supply and its cable; it is used again once it stays connected."
        )
        return Link(name=self._name, state="down", message=message)

    def _note_losses(self, now_ns: int, *, is_up: bool) -> None:
        if is_up and not self._was_up:
            self._up_since_ns = now_ns
        if self._was_up and not is_up:
            self._losses_ns.append(now_ns)
        self._was_up = is_up
        since_ns = now_ns - LOSSES_WITHIN_NS
        is_steady = is_up and now_ns - self._up_since_ns >= STEADY_NS
        self._losses_ns = [] if is_steady else [at for at in self._losses_ns if at > since_ns]

    def _present_link(self, now_ns: int) -> Link:
        if not self._is_open:
            state = "down" if self._trouble else "searching"
            message = self._trouble or f"{self._device.path} is being opened."
            return Link(name=self._name, state=state, message=message)
        if self._refused_since_ns is not None:
            # At once: what is refused is what the robot is told, and the board stops by itself.
            return Link(name=self._name, state="down", message=self._takes_nothing)
        status = self.dialogue.status(now_ns)
        message = f"{self._device.path}: {status.message}" if status.message else ""
        return Link(name=self._name, state=status.state, message=message)

    def counts(self, known: Mapping[str, int]) -> dict[str, int]:
        """Return a dialogue's counts with those of the line."""
        dropped = self._device.take_dropped()
        refused, self._refused_writes = self._refused_writes, 0
        lines = {
            f"{self._name}/dropped_bytes": dropped,
            f"{self._name}/not_sent": refused,
            f"{self._name}/strangers": self._device.take_strangers(),
        }
        return dict(known) | {name: count for name, count in lines.items() if count}

    def close(self) -> None:
        """Say goodbye and let go of the port."""
        self._device.close(self.dialogue.goodbye() if self._is_open else ())
        self._is_open = False


def joined(events: Sequence[Event]) -> list[Event]:
    """Put what arrived in a row together, with the time of the last."""
    found: list[Event] = []
    for event in events:
        if found and isinstance(event, Arrived) and isinstance(found[-1], Arrived):
            found[-1] = Arrived(found[-1].data + event.data, event.monotonic_ns)
        else:
            found.append(event)
    return found
