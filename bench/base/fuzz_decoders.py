"""Decoders under rubbish: damaged streams without end; nothing may raise, grow or go unnoticed.

    python -m bench.base.fuzz_decoders [--seconds 10] [--seed N]

Each round damages an honest stream (flipped bits, cuts, repeats, noise, false headers), cuts it at
random and feeds it to a device's dialogue, while a plain decoder finds its frames. Afterwards the
dialogue must come back on honest data. A failure prints the seed of its round.
"""

import argparse
import random
import time
import tracemalloc
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
from bench.base.decoding import started
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.record import chunks

HONEST_FRAMES = 400
MOST_GROWTH_BYTES = 2_000_000

Fuzz = Callable[[random.Random], None]
"""One round; it asserts what must hold."""


def damaged(frames: list[bytes], rng: random.Random) -> bytes:
    """An honest stream after a bad cable, a neighbouring motor and a stuck buffer."""
    parts: list[bytes] = []
    for _ in range(rng.randrange(1, 150)):
        frame = bytearray(rng.choice(frames))
        match rng.randrange(9):
            case 0:
                frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
            case 1:
                del frame[rng.randrange(len(frame)) :]
            case 2:
                del frame[: rng.randrange(len(frame))]
            case 3:
                frame *= 2
            case 4:
                frame += rng.randbytes(rng.randrange(200))
            case 5:
                frame[:] = frame[:2] * rng.randrange(1, 100)
            case _:
                pass
        parts.append(bytes(frame))
    return b"".join(parts)


def pieces(data: bytes, rng: random.Random) -> Iterator[bytes]:
    """Cut data anyhow."""
    start = 0
    while start < len(data):
        end = start + rng.choice((1, 7, 60, 350, 5000))
        yield data[start:end]
        start = end


def lidar_fuzz(title: str) -> Fuzz:
    """A lidar's round."""
    record = RECORDS[title]
    frames = [frame.data for frame in islice(record.stream(), HONEST_FRAMES)]
    honest = chunks(record.stream(), record.baud, 1.5, 0.02)

    def play(rng: random.Random) -> None:
        lidar, plain = started(title), record.finder()
        data = damaged(frames, rng)
        now_ns = skipped = bad = 0
        for piece in pieces(data, rng):
            now_ns += round(len(piece) * 10 / record.baud * 1e9)
            now_ns += rng.choice((0, 0, 0, 300_000_000))
            lidar.receive(piece, now_ns)
            reading = lidar.take(now_ns)
            skipped += reading.counts.get("lidar/skipped_bytes", 0)
            bad += reading.counts.get("lidar/bad_checksum", 0)
            for scan in reading.scans:
                assert np.isfinite(
                    [scan.angle_min, scan.angle_increment, scan.time_increment]
                ).all()
                assert scan.angle_increment > 0.0
                assert len(scan.ranges) * scan.angle_increment < 2 * np.pi + scan.angle_increment
                assert not np.isnan(scan.ranges).any()
        plain.feed(data)
        assert bad == plain.bad
        assert 0 <= plain.skipped - skipped < 20  # the longest header
        for at_s, piece in honest:
            lidar.receive(piece, now_ns + round(at_s * 1e9))
        end_ns = now_ns + round(honest[-1][0] * 1e9)
        assert lidar.take(end_ns).scans
        assert lidar.status(end_ns).state == "up"

    return play


# Other devices join here: a name, and a function that plays one round.
FUZZES: dict[str, Fuzz] = {title: lidar_fuzz(title) for title in RECORDS}


def main() -> None:
    """Fuzz each device for its share of the time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="in all")
    parser.add_argument("--seed", type=int, default=None, help="play one round again")
    options = parser.parse_args()
    tracemalloc.start()
    for name, fuzz in FUZZES.items():
        seed = random.randrange(2**32) if options.seed is None else options.seed
        fuzz(random.Random(seed))  # what is loaded once is not growth
        before, rounds = tracemalloc.get_traced_memory()[0], 1
        end_s = time.monotonic() + options.seconds / len(FUZZES)
        while options.seed is None and time.monotonic() < end_s:
            seed, rounds = seed + 1, rounds + 1
            try:
                fuzz(random.Random(seed))
            except BaseException:
                print(f"{name}: failed in the round of --seed {seed}", flush=True)
                raise
        growth = tracemalloc.get_traced_memory()[0] - before
        assert growth < MOST_GROWTH_BYTES, f"{name} keeps {growth} bytes more after {rounds} rounds"
        print(f"{name:20s} {rounds:4d} rounds, {growth / 1000:.0f} kB more kept", flush=True)


if __name__ == "__main__":
    main()
