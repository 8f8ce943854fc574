"""Lidars at their full rate: the share of one core that decoding takes, and plain Python's.

    python -m bench.base.decoding [--seconds 4] [--chunk-ms 10 20 50]

Each stream is what an honest sensor sends, cut as it arrives when the port is read every 10, 20 or
50 ms. Measured is all from bytes to scans, as base does it. Plain Python, in the same run, finds
the same frames byte by byte and sorts their samples into whole degrees; it stamps nothing, fits no
grid and knows no mounting. What ours costs is mostly the number of readings, not of bytes.
"""

import argparse
import struct
import time
from collections.abc import Callable

from bench.base.lidar_streams import STREAMS, chunks
from bench.base.plain_lidars import PlainDriver

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.lidars import make_lidar

# What an RPLIDAR or a YDLIDAR says before it streams.
ANSWERS = {
    b"\xa5\x50": bytes.fromhex("A55A14000000 04 18") + bytes(19),
    b"\xa5\x90": bytes.fromhex("A55A14000000 04 06") + bytes(19),
    b"\xa5\x52": bytes.fromhex("A55A03000000 06 000000"),
    b"\xa5\x92": bytes.fromhex("A55A03000000 06 000000"),
    b"\xa5\x59": bytes.fromhex("A55A04000000 15") + struct.pack("<HH", 508, 254),
    b"\xa5\x20": bytes.fromhex("A55A05000040 81"),
    b"\xa5\x60": bytes.fromhex("A55A05000040 81"),
    bytes.fromhex("A58205000000000022"): bytes.fromhex("A55A54000040 82"),
}
HOKUYO = {
    b"VV\n": b"VV\n00P\nPROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[\nPROT:SCIP 2.0;N\n\n",
    b"PP\n": b"PP\n00P\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\nAMIN:44;7\nAMAX:725;o\n"
    b"AFRT:384;6\nSCAN:600;e\n\n",
    b"MD0044072501000\n": b"MD0044072501000\n00P\n\n",
}
"""What a URG-04LX says."""
YDLIDARS = {"YDLIDAR G2": 15, "YDLIDAR G4": 5, "YDLIDAR T-mini": 151}
"""What they call themselves."""
# Number, period of the typical mode [1/256 us], and what begins its stream.
TYPICAL = {
    "RPLIDAR A3": (0x31, 16000, "A55A84000040 84"),
    "RPLIDAR C1": (0x41, 51200, "A55A54000040 85"),
    "RPLIDAR S2": (0x71, 8000, "A55A54000040 85"),
    "RPLIDAR S3": (0x81, 8000, "A55AAA000040 86"),
}


def answers_of(title: str) -> dict[bytes, bytes]:
    """What the sensor says to what it is asked."""
    if title == "Hokuyo URG":
        return dict(HOKUYO)
    if title in YDLIDARS:
        number = YDLIDARS[title]
        info = bytes.fromhex("A55A14000000 04") + bytes([number]) + bytes(19)
        return ANSWERS | {b"\xa5\x90": info, b"\xa5\xd1": bytes.fromhex("A55A01000000 04 02")}
    if title not in TYPICAL:
        return ANSWERS
    number, period, stream = TYPICAL[title]
    said = {
        "A58404 7C000000 59": "A55A06000000 20 7C000000 0100",
        "A58406 71000000 0000 56": f"A55A08000000 20 71000000 {struct.pack('<I', period).hex()}",
        "A58406 71000000 0100 57": f"A55A08000000 20 71000000 {struct.pack('<I', period).hex()}",
        "A58404 01000000 24": "A55A08000000 20 01000000 58020000",
        "A58205 01 0000 0000 23": stream,
    }
    info = {b"\xa5\x50": bytes.fromhex("A55A14000000 04") + bytes([number, 30, 1]) + bytes(17)}
    asked = {bytes.fromhex(question): bytes.fromhex(answer) for question, answer in said.items()}
    return ANSWERS | info | asked


STARTING = 100


def started(title: str) -> LidarDialogue:
    """A dialogue whose sensor is about to stream, at time 0."""
    mode = "standard" if "standard" in title else "auto"
    lidar = make_lidar(LidarConfig(model=STREAMS[title][0], mode=mode))
    answers = answers_of(title)
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
    _, baud, stream = STREAMS[title]
    arrivals = chunks(stream(), baud, seconds, chunk_s)
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
    for title in STREAMS:
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
