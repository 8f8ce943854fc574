"""XV11 and LDS-01: one sample in each degree, a fixed number of degrees in a packet."""

import numpy as np

from trolley_base.emulators.lidar import LidarFacts, Mount, Samples, SpinningLidar
from trolley_base.world import LidarSpec


class DegreeLidar(SpinningLidar):
    """A lidar whose packets begin at multiples of `per_packet` degrees."""

    def __init__(
        self,
        facts: LidarFacts,
        per_packet: int,
        mount: Mount,
        errors: LidarSpec,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(facts, mount, errors, rng)
        self._per_packet = per_packet
        self._index = 0
        self._ranges_mm: list[int] = []

    def restart(self, now_ns: int) -> None:
        """Start streaming."""
        super().restart(now_ns)
        self._ranges_mm.clear()

    def _emit(self, samples: Samples) -> None:
        degrees = np.rint(samples.heads_deg).astype(np.int64) % 360
        rows = zip(
            samples.times_ns.tolist(), degrees.tolist(), samples.ranges_mm.tolist(), strict=True
        )
        for time_ns, degree, range_mm in rows:
            is_first = degree % self._per_packet == 0 or self.is_stuck
            if not self._ranges_mm and not is_first:
                continue  # a head that was stuck continues in the middle of a packet
            if not self._ranges_mm:
                self._index = degree // self._per_packet
            self._ranges_mm.append(range_mm)
            if len(self._ranges_mm) == self._per_packet:
                self._send(time_ns, self._encode(self._index, samples.hz, self._ranges_mm))
                self._ranges_mm = []

    def _encode(self, index: int, hz: float, ranges_mm: list[int]) -> bytes:
        """Make a packet; `ranges_mm` is 0 where there is no range."""
        raise NotImplementedError
