"""Lidars at their full rate: the share of one core that decoding takes, and plain Python's.

    python -m bench.base.decoding [--seconds 4] [--chunk-ms 10 20 50]

Each stream is what an honest sensor sends, cut as it arrives when the port is read every 10, 20 or
50 ms. Measured is all from bytes to scans, as base does it. Plain Python, in the same run, finds
the same frames byte by byte and sorts their samples into whole degrees; it stamps nothing, fits no
grid and knows no mounting. What ours costs is mostly the number of readings, not of bytes.
"""

import argparse
import time
from collections.abc import Callable

from bench.base.lidars.catalogue import RECORDS, PlainDriver
from bench.base.lidars.record import chunks

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.lidars import make_lidar

STARTING = 100


def started(title: str) -> LidarDialogue:
    """A dialogue whose sensor is about to stream, at time 0."""
    record = RECORDS[title]
    lidar = make_lidar(LidarConfig(model=record.model, mode=record.mode))
    answers = {**record.answers, **record.begins}
    now_ns = -STARTING * 20_000_000
    lidar.begin(now_ns)
    for _ in range(STARTING):
        if answer := answers.get(lidar.outgoing(now_ns)):
            lidar.receive(answer, now_ns)
        now_ns += 20_000_000
    return lidar


def share_of_core(work: Callable[[], None], seconds: float) -> float:
    """CPU time of this process over the time that the stream took."""
    begun_s = time.process_time()
    work()
    return (time.process_time() - begun_s) / seconds


def measure(title: str, seconds: float, chunk_s: float) -> tuple[float, float, int]:
    """Return the shares of one core, ours and plain Python's, and how many scans came of it."""
    record = RECORDS[title]
    arrivals = chunks(record.stream(), record.baud, seconds, chunk_s)
    lidar, plain = started(title), PlainDriver(title)
    num_scans = 0

    def ours() -> None:
        nonlocal num_scans
        for at_s, data in arrivals:
            now_ns = round(at_s * 1e9)
            lidar.receive(data, now_ns)
            num_scans += len(lidar.take(now_ns).scans)

    def plainly() -> None:
        for _, data in arrivals:
            plain.feed(data)

    return share_of_core(ours, seconds), share_of_core(plainly, seconds), num_scans


def main() -> None:
    """Measure each model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=4.0, help="of each stream")
    parser.add_argument("--chunk-ms", type=float, nargs="+", default=[10.0, 20.0, 50.0])
    options = parser.parse_args()
    for title in RECORDS:
        for chunk_ms in options.chunk_ms:
            ours, plain, scans = measure(title, options.seconds, chunk_ms / 1000.0)
            print(
                f"{title:20s} read every {chunk_ms:2.0f} ms: {100 * ours:5.2f} % of a core,"
                f" plain Python {100 * plain:5.1f} %, {plain / ours:4.1f} times as much;"
                f" {scans / options.seconds:.1f} scans/s",
                flush=True,
            )


if __name__ == "__main__":
    main()
