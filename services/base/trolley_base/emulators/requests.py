"""Requests of the Slamtec kind, which YDLIDAR took over: `A5`, command, perhaps a payload."""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass

HAS_PAYLOAD = 0x80


@dataclass(frozen=True, slots=True)
class Request:
    """What the host asked for."""

    command: int
    payload: bytes = b""


class Requests:
    """Finds requests among the bytes of the host; a wrong checksum drops the request.

    Args:
        has_payload: whether a command brings length, payload and checksum.
    """

    def __init__(
        self, has_payload: Callable[[int], bool] = lambda command: bool(command & HAS_PAYLOAD)
    ) -> None:
        self._has_payload = has_payload
        self._pending = bytearray()

    def clear(self) -> None:
        """Forget what has arrived of a request."""
        self._pending.clear()

    def take(self, data: bytes) -> list[Request]:
        """Return the requests that these bytes complete."""
        found: list[Request] = []
        for byte in data:
            if not self._pending and byte != 0xA5:
                continue
            self._pending.append(byte)
            have = self._pending
            if len(have) == 2 and not self._has_payload(have[1]):
                found.append(Request(have[1]))
                have.clear()
            elif len(have) >= 3 and len(have) == have[2] + 4:
                if xor_of(have) == 0:
                    found.append(Request(have[1], bytes(have[3:-1])))
                have.clear()
        return found


def xor_of(values: Iterable[int]) -> int:
    """Return the exclusive or of all bytes."""
    result = 0
    for value in values:
        result ^= value
    return result


def descriptor(length: int, kind: int, *, repeats: bool = False) -> bytes:
    """What comes before an answer: its length in bytes, its type, whether more follow."""
    return b"\xa5\x5a" + struct.pack("<I", length | (1 << 30 if repeats else 0)) + bytes([kind])
