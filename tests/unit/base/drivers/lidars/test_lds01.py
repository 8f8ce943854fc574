"""An LDS-01 whose checksum is not the one that is known, and where nothing comes back."""

import random
from collections import Counter
from typing import Literal

import numpy as np
import pytest
from bench.base.lidars.lds01 import lds01_frame, lds01_stream
from bench.base.lidars.record import chunks

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar


def read(spoil: list[bool], seconds: float = 3.0) -> tuple[list[LidarScan], Counter[str]]:
    """Read a stream in which some of the sums are wrong.

    Args:
        spoil: of each frame, over and over, whether its sum is.
        seconds: of the stream.
    """
    lidar = make_lidar(LidarConfig(model="lds01"))
    lidar.begin(0)
    scans: list[LidarScan] = []
    counts: Counter[str] = Counter()

    def stream():
        for number, frame in enumerate(lds01_stream()):
            if spoil[number % len(spoil)]:
                wrong = bytes([frame.data[40] ^ 0x5A, frame.data[41] ^ 0xA5])
                frame = type(frame)(frame.at_s, frame.data[:40] + wrong)
            yield frame

    for at_s, data in chunks(stream(), 230400, seconds, 0.02):
        lidar.receive(data, round(at_s * 1e9))
        reading = lidar.take(round(at_s * 1e9))
        scans += reading.scans
        counts += Counter(reading.counts)
    return scans, counts


def test_wrong_sums_throughout_are_counted_and_do_not_mute_it() -> None:
    right, none = read([False])
    assert not none
    scans, counts = read([True])
    assert len(right) - 3 <= len(scans) < len(right)
    assert counts["lidar/bad_checksum"] > 0.8 * 3.0 * 300
    assert all((scan.ranges == right[-1].ranges).all() for scan in scans)


def test_where_some_sums_are_right_the_wrong_ones_are_noise() -> None:
    scans, counts = read([False] * 9 + [True])
    assert scans
    for scan in scans:
        assert 30 <= (scan.ranges == 0.0).sum() <= 42
    assert 80 <= counts["lidar/bad_checksum"] <= 95


def test_frames_out_of_order_are_not_believed_without_their_sums() -> None:
    lidar = make_lidar(LidarConfig(model="lds01"))
    lidar.begin(0)
    dice = random.Random(4)
    for tick in range(400):
        data = b"".join(
            bytes([0xFA, dice.randrange(0xA0, 0xDC)]) + dice.randbytes(40) for _ in range(6)
        )
        lidar.receive(data, tick * 20_000_000)
        assert not lidar.take(tick * 20_000_000).scans


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("no_echo", [None, "hold"])
def test_silent_are_beams_that_were_measured_and_brought_nothing_back(
    sense: float, no_echo: Literal["hold"] | None
) -> None:
    def distance_mm(degree: int) -> int:
        return 0 if 90 <= degree < 180 else 50 if degree == 200 else 1000 + degree

    lidar = make_lidar(
        LidarConfig(
            model="lds01", no_echo=no_echo, reversed=sense > 0.0, masks_deg=[(150.0, 160.0)]
        )
    )
    lidar.begin(0)
    scans: list[LidarScan] = []
    for number in range(300):
        first = 6 * (number % 60)
        if first != 120:  # this frame is always lost
            samples = [(200, distance_mm(first + one)) for one in range(6)]
            lidar.receive(lds01_frame(number % 60, 300.0, samples), round(number * 1e9 / 300.0))
        scans += lidar.take(round(number * 1e9 / 300.0)).scans
    assert scans
    for scan in scans:
        if no_echo == "hold":
            assert len(scan.silent) == 0
            continue
        angles = np.degrees(scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges)))
        silent = {round(sense * angle) % 360 for angle in angles[scan.silent]}
        masked = {degree for degree in range(90, 180) if 150 <= sense * degree % 360 <= 160}
        assert silent == set(range(90, 180)) - masked - set(range(120, 126))
