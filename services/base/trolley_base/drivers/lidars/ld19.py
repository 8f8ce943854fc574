"""LDROBOT's lidars: 12 samples a frame, each with its intensity.

LD06, LD19, STL-06P, STL-19P, STL-26 and, faster, STL-27L stream from power-up. The LD14P has the
same frames; it looks from beside its axis, so where it looked depends on the distance
(`triangulation_deg`), and it can be started and stopped.

Frame of 47 bytes: 54 2C, speed [deg/s], angle of the first sample [0.01 deg], 12 × (distance [mm],
intensity), angle of the last sample, time [ms], CRC-8. Command of 8 bytes: 54, which, 04, a word
of 32 bits, the same CRC-8.

Source:
    LDROBOT, LD19 development manual; ldlidar_stl_ros2, launch/stl27l.launch.py for the speed of
    the STL-27L; for the LD14P kaiaai/LDS, which took it from ldlidar_sl_sdk.
"""

from collections import Counter
from collections.abc import Callable
from functools import partial

import numpy as np
from msgspec import Struct

from trolley.config.hardware import LidarConfig
from trolley.drivers import API, read_settings
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, turned_deg, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import SETTINGS, LidarDriver, LidarFacts
from trolley_base.drivers.lidars.scan_grid import Floats
from trolley_base.drivers.lidars.streaming import StartedLidar, StreamingLidar

FRAME_BYTES, SAMPLES = 47, 12
POLYNOMIAL = 0x4D
START, STOP = bytes.fromhex("54A0 04 00000000 5E"), bytes.fromhex("54A1 04 00000000 4A")
"""Of an LD14P."""
BESIDE_MM, SLOPE, AHEAD_MM = -18.975571, 0.11923, 5.9
"""Of an LD14P's triangulation: where it sits beside and ahead of its axis [mm], and how far it
looks to the side [1]."""

FACTS = LidarFacts(
    title="LD19",
    baud=230400,
    range_min_m=0.02,
    range_max_m=12.0,
    turns_hz=(5.0, 13.0),
    usual_hz=10.0,
    speed_hint="Its PWM wire must be tied to ground for it to keep its speed by itself.",
)
FACTS_27L = LidarFacts(
    title="STL-27L",
    baud=921600,
    range_min_m=0.03,
    range_max_m=25.0,
    turns_hz=(5.0, 13.0),
    usual_hz=10.0,
    speed_hint=FACTS.speed_hint,
)
FACTS_14P = LidarFacts(
    title="LD14P",
    baud=230400,
    range_min_m=0.1,
    range_max_m=8.0,
    turns_hz=(2.0, 8.0),
    usual_hz=6.0,
)


def _crc_tables() -> Bytes:
    """Return (47, 256): what each value of each byte adds to the CRC; it is linear over xor."""
    tables = np.empty((FRAME_BYTES, 256), np.uint8)
    tables[-1] = np.arange(256)  # the CRC itself: a good frame's parts cancel
    for byte in range(FRAME_BYTES - 2, -1, -1):
        tables[byte] = tables[byte + 1]
        for _ in range(8):
            tables[byte] = (tables[byte] << 1) ^ (tables[byte] >> 7) * np.uint8(POLYNOMIAL)
    return tables


_TABLES = _crc_tables()
_ROWS = np.arange(FRAME_BYTES)


def _lengths(heads: Bytes) -> Indices:
    return np.where((heads[:, 0] == 0x54) & (heads[:, 1] == 0x2C), FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    return np.bitwise_xor.reduce(_TABLES[_ROWS, frames], axis=1) == 0


FORMAT = FrameFormat(2, FRAME_BYTES, _lengths, _check)


def triangulation_deg(range_m: Floats) -> Floats:
    """Return what to add to the head's angle of an LD14P for where it looked.

    Args:
        range_m: (n, m) what it found, 0 for nothing: taken as far away, as most of it is.

    Source:
        sl_transform.cpp of ldlidar_sl_sdk, as kaiaai/LDS gives it.
    """
    millimetres = np.where(range_m > 0.0, range_m * 1000.0, 1e6)
    beside = SLOPE * millimetres + BESIDE_MM
    return -np.degrees(np.arctan2(beside, millimetres + AHEAD_MM))


class LdDecoder(FrameDecoder):
    """Reads its frames.

    Args:
        facts: of the model.
        counts: what goes wrong is added here.
        shift_deg: where a beam looks beside the head, of the ranges found [m]; None: nowhere.
    """

    def __init__(
        self,
        facts: LidarFacts,
        counts: Counter[str],
        shift_deg: Callable[[Floats], Floats] | None = None,
    ) -> None:
        super().__init__(FORMAT, facts.usual_hz, counts)
        self._shift_deg = shift_deg

    def _samples(self, frames: Frames) -> Decoded:
        head = words(frames.data[:, 2:6]).astype(np.float64)
        end = words(frames.data[:, 42:44])[:, 0].astype(np.float64)
        first = head[:, 1] / 100.0
        width = turned_deg(first, end / 100.0)
        angle = first[:, None] + width[:, None] * (np.arange(SAMPLES) / (SAMPLES - 1))
        points = frames.data[:, 6:42].reshape(len(frames), SAMPLES, 3).astype(np.float64)
        range_m = (points[:, :, 0] + 256.0 * points[:, :, 1]) / 1000.0
        shift_deg = None if self._shift_deg is None else self._shift_deg(range_m)
        return self._evenly(frames, angle, head[:, 0], (range_m, points[:, :, 2]), shift_deg)


class Ld19Settings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What only an LD19 has."""

    speckle_filter: bool = False
    """Whether dim single echoes nearer than 5 m are dropped, as LDROBOT's own driver does; thin
    things, such as the legs of chairs, may then not be seen."""


def _ld19(config: LidarConfig) -> StreamingLidar:
    settings = read_settings(config.settings, Ld19Settings, SETTINGS)
    decoder = partial(LdDecoder, FACTS)
    return StreamingLidar(FACTS, config, decoder, drops_speckles=settings.speckle_filter)


def _stl27l(config: LidarConfig) -> StreamingLidar:
    return StreamingLidar(FACTS_27L, config, partial(LdDecoder, FACTS_27L))


def _ld14p(config: LidarConfig) -> StartedLidar:
    decoder = partial(LdDecoder, FACTS_14P, shift_deg=triangulation_deg)
    return StartedLidar(FACTS_14P, config, decoder, START, STOP)


EMULATOR = "trolley_base.emulators.ld19:LIDARS"
DRIVERS: dict[str, LidarDriver] = {
    "ld19": LidarDriver(
        FACTS,
        _ld19,
        frames=FORMAT,
        settings=Ld19Settings,
        linorobot_names=("ld06", "ld19"),
        ros_packages=("ldlidar_stl_ros",),
        api=API,
        page="ld19.md",
        emulator=EMULATOR,
    ),
    "stl27l": LidarDriver(
        FACTS_27L,
        _stl27l,
        frames=FORMAT,
        api=API,
        page="stl-27l.md",
        emulator=EMULATOR,
    ),
    "ld14p": LidarDriver(
        FACTS_14P,
        _ld14p,
        frames=FORMAT,
        start=START,
        stop=STOP,
        api=API,
        page="ld14p.md",
        emulator=EMULATOR,
    ),
}
