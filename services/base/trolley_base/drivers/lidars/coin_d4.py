"""COIN-D4 (TurtleBot3's LDS-03): streams once it is told to, up to 40 samples a frame.

Its frames are those of a YDLIDAR with intensities, sum included: AA 55, kind, number of samples,
angles of the first and the last sample, XOR of all words, samples of three bytes. A kind with bit 0
set begins a turn and holds how fast the last one was above it [0.1 turns/s]. Of a sample the last
14 bits are a distance [mm], 0 for none, the eight before them an intensity. It measures times of
flight: what it saw lies where its head pointed.

A command is AA 55, which, and the XOR of the three.

Source:
    ROBOTIS, coin_d4_driver (version M1CT_TOF, its default); kaiaai/LDS, LDS_COIN_D4A.
"""

from collections import Counter

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, latest, turned_deg, words
from trolley_base.drivers.lidars.frames import Frames
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.revolutions import Samples
from trolley_base.drivers.lidars.streaming import StartedLidar
from trolley_base.drivers.lidars.ydlidar import FORMAT_WITH_INTENSITY, HEAD_BYTES

START, STOP = bytes.fromhex("AA55F00F"), bytes.fromhex("AA55F50A")
UNITS_PER_DEG = 64.0
DPS_PER_COUNT = 36.0

FACTS = LidarFacts(
    title="COIN-D4",
    baud=230400,
    range_min_m=0.1,
    range_max_m=8.0,
    turns_hz=(5.0, 13.0),
    usual_hz=10.0,
)


class CoinDecoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT_WITH_INTENSITY, FACTS.usual_hz, counts)
        self._rate_dps = 360.0 * FACTS.usual_hz

    def _samples(self, frames: Frames) -> Decoded:
        kinds, sizes = frames.data[:, 2].astype(np.int64), frames.data[:, 3].astype(np.int64)
        ends_deg = (words(frames.data[:, 4:8]) >> 1) / UNITS_PER_DEG
        steps_deg = turned_deg(*ends_deg.T) / np.maximum(sizes - 1, 1)
        points = frames.data[:, HEAD_BYTES:].reshape(len(frames), -1, 3).astype(np.int64)
        inside = np.arange(points.shape[1], dtype=np.int64) < sizes[:, None]
        frame, number = np.nonzero(inside)
        angle = (ends_deg[frame, 0] + steps_deg[frame] * number) % 360.0
        first, middle, last = points[inside].T
        range_m = (middle >> 2 | last << 6) / 1000.0
        intensity = (first >> 2 | (middle & 3) << 6).astype(np.float64)
        speeds = (kinds >> 1).astype(np.float64) * DPS_PER_COUNT
        rates = latest(self._rate_dps, (kinds & 1) == 1, speeds)
        self._rate_dps = float(rates[-1])
        angle, elapsed_s, begins = self._rotation.follow(angle, rates[frame])
        samples = Samples(angle, np.zeros(len(angle)), elapsed_s, begins, range_m, intensity)
        behind = frames.behind + frames.lengths
        return Decoded(samples, np.cumsum(sizes) - 1, behind, self._rate_dps / 360.0)


class CoinD4(StartedLidar):
    """The sensor; see the module. The maker's driver clears DTR.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, config: LidarConfig) -> None:
        super().__init__(FACTS, config, CoinDecoder, START, STOP)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self.baud, dtr=False)


DRIVERS: dict[str, LidarDriver] = {
    "coin_d4": LidarDriver(
        FACTS,
        CoinD4,
        frames=FORMAT_WITH_INTENSITY,
        start=START,
        stop=STOP,
        ros_packages=("coin_d4_driver",),
        api=API,
        page="coin-d4.md",
        emulator="trolley_base.emulators.coin_d4:LIDARS",
    )
}
