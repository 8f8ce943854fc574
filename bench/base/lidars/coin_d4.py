"""COIN-D4: a TurtleBot3's LDS-03."""

from collections.abc import Iterator
from functools import partial

from bench.base.lidars.record import (
    Example,
    Frame,
    Judged,
    LidarRecord,
    PlainFrames,
    Polar,
    Start,
    distance_m,
)
from bench.base.lidars.ydlidar import yd_frames, yd_length

from trolley_base.drivers.lidars import coin_d4 as driver
from trolley_base.drivers.lidars.ydlidar import FORMAT_WITH_INTENSITY
from trolley_base.emulators import coin_d4


def coin_d4_stream() -> Iterator[Frame]:
    """5000 samples a second, 500 a turn, 20 in the last packet of each."""
    index, heads = 0, [round(i * 0.72 * 64) for i in range(500)]
    while True:
        first = index % 500
        own = heads[first : first + 40]
        points = (coin_d4.point(round(1000 * distance_m(one / 64)), 150) for one in own)
        index += len(own)
        frame = coin_d4.encode(None if first else 100, (own[0], own[-1]), b"".join(points))
        yield Frame((index - 1) / 5000.0, frame)


def coin_d4_check(frame: bytes) -> bool:
    """Two XORs: of the even bytes before it and two of each sample, and of all others."""
    even = odd = 0
    for at in range(0, 8, 2):
        even, odd = even ^ frame[at], odd ^ frame[at + 1]
    for at in range(10, len(frame), 3):
        even, odd = even ^ frame[at] ^ frame[at + 1], odd ^ frame[at + 2]
    return (even, odd) == (frame[8], frame[9])


def coin_d4_samples(frame: bytes) -> Polar:
    """Evenly between two angles, 14 bits each."""
    count = frame[3]
    first, last = ((frame[at] + 256 * frame[at + 1]) // 2 for at in (4, 6))
    step = (last - first) % 23040 / max(1, count - 1)
    return [
        ((first + i * step) / 64 % 360, frame[11 + 3 * i] // 4 + 64 * frame[12 + 3 * i])
        for i in range(count)
    ]


def plain_coin(begins: int, heads: tuple[int, int], distances_mm: list[int]) -> bytes:
    """Make a frame of distances [mm], each with some intensity."""
    points = b"".join(coin_d4.point(one % 16384, one % 251) for one in distances_mm)
    return coin_d4.encode(100 if begins else None, heads, points)


RECORDS = {
    "COIN-D4": LidarRecord(
        model="coin_d4",
        baud=230400,
        turns_hz=10.0,
        samples_per_s=5000.0,
        stream=coin_d4_stream,
        finder=lambda: PlainFrames(partial(yd_length, sample_bytes=3), coin_d4_check),
        reader=lambda: coin_d4_samples,
        examples=(
            Example(
                "AA55C902 01050106 0B54 00A00F 00C80F", (10.0, 12.0), (1.0, 1.01), (0, 0), 10.0
            ),
        ),
        emulated=Start(bytes.fromhex("AA55F00F")),
        form=FORMAT_WITH_INTENSITY,
        header=b"\xaa\x55\x00\x28\x01\x00\x01",
        judged=Judged(driver.CoinDecoder, yd_frames(plain_coin, 40)),
    ),
}
