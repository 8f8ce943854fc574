"""3irobotix Delta-2A, its newer 2G, and 2B."""

from collections import Counter
from collections.abc import Iterator
from functools import partial

import numpy as np
from bench.base.lidars.record import (
    Example,
    Frame,
    Judged,
    LidarRecord,
    Make,
    PlainFrames,
    Polar,
    distance_m,
    distances,
)

from trolley_base.drivers.lidars import delta2 as driver
from trolley_base.emulators import delta2


def delta2_stream(turn: tuple[int, int]) -> Iterator[Frame]:
    """Six turns a second of so many packets with so many samples."""
    packets, per_packet = turn
    step, index = 360.0 / (packets * per_packet), 0
    while True:
        first = index % (packets * per_packet)
        samples = [round(4000 * distance_m((first + i) * step)) for i in range(per_packet)]
        index += per_packet
        frame = delta2.encode(6.0, first * step, [(50, quarters) for quarters in samples])
        yield Frame((index - 1) * step / 360.0 / 6.0, frame)


def delta2_length(data: bytes) -> int | None:
    """AA, length, 01 61, AD or AE, length of the rest, which fit each other and the kind."""
    known = {0: b"\xaa", 3: b"\x01", 4: b"\x61", 5: b"\xad\xae"}
    if any(data[at] not in known.get(at, bytes(range(256))) for at in range(min(len(data), 8))):
        return 0
    if len(data) < 8:
        return None
    length, rest = data[1] * 256 + data[2], data[6] * 256 + data[7]
    fits = rest in (1, 5) if data[5] == 0xAE else rest in range(8, 5 + 3 * 61 + 1, 3)
    return length + 2 if fits and length == rest + 8 else 0


def delta2_check(frame: bytes) -> bool:
    """The sum of all bytes before it."""
    return sum(frame[:-2]) % 65536 == frame[-2] * 256 + frame[-1]


def delta2_samples(frame: bytes, packets: int = 16) -> Polar:
    """So many a packet, evenly up to the next packet's angle."""
    if frame[5] == 0xAE:
        return []
    count = (frame[6] * 256 + frame[7] - 5) // 3
    first, found = (frame[11] * 256 + frame[12]) / 100, []
    for i in range(count):
        _, high, low = frame[13 + 3 * i : 16 + 3 * i]
        found.append(((first + i * 360 / packets / count) % 360, (high * 256 + low) / 4))
    return found


def delta2_frames(packets: int) -> Make:
    """Frames of a sensor that sends so many a turn."""

    def frames(rng: np.random.Generator) -> list[bytes]:
        data, index = [], int(rng.integers(packets))
        for i in range(4):
            count = int(rng.integers(1, 62))
            # The second packet tells how many make a turn; the first holds nothing here.
            quarters = [0] * count if i == 0 else distances(rng, 65536, count)
            angle = (index + i) % packets * 360.0 / packets
            data.append(delta2.encode(6.0, angle, [(one % 251, one) for one in quarters]))
        return data

    return frames


def of_2a(counts: Counter[str]) -> driver.Delta2Decoder:
    """Make the decoder of a Delta-2A."""
    return driver.Delta2Decoder(driver.FACTS_2A, counts)


RECORDS = {
    "Delta-2A": LidarRecord(
        model="delta2a",
        baud=115200,
        turns_hz=6.0,
        samples_per_s=1920.0,
        stuck_deg=22.5,
        stream=lambda: delta2_stream(delta2.A_TURN),
        finder=lambda: PlainFrames(delta2_length, delta2_check),
        reader=lambda: delta2_samples,
        examples=(
            Example(
                "AA001601 61AD000E 7800000960 320FA0 320FA4 320FA8 056D",
                (24.0, 31.5, 39.0),
                (1.0, 1.001, 1.002),
                [50] * 3,
                6.0,
            ),
        ),
        form=driver.FORMAT,
        header=b"\xaa\x00\x49\x01\x61\xad\x00\x41",
        judged=Judged(of_2a, delta2_frames(16)),
    ),
    "Delta-2G": LidarRecord(
        model="delta2a",
        baud=115200,
        turns_hz=6.0,
        samples_per_s=6.0 * delta2.G_TURN[0] * delta2.G_TURN[1],
        stuck_deg=24.0,
        stream=lambda: delta2_stream(delta2.G_TURN),
        finder=lambda: PlainFrames(delta2_length, delta2_check),
        reader=lambda: partial(delta2_samples, packets=15),
        emulated=None,
        judged=Judged(of_2a, delta2_frames(15)),
    ),
    "Delta-2B": LidarRecord(
        model="delta2b",
        baud=230400,
        turns_hz=6.0,
        samples_per_s=3840.0,
        stuck_deg=22.5,
        is_twin=True,
        stream=lambda: delta2_stream(delta2.B_TURN),
        finder=lambda: PlainFrames(delta2_length, delta2_check),
        reader=lambda: delta2_samples,
    ),
}
