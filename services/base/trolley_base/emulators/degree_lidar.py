"""XV11, LDS-01, Delta-2: a sample at each step of a turn, a fixed number of steps in a packet."""

import numpy as np

from trolley_base.emulators.lidar import LidarFacts, Mount, Samples, SpinningLidar
from trolley_base.world import LidarSpec


class DegreeLidar(SpinningLidar):
    """A lidar whose packets begin at multiples of `per_packet` steps."""

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
        of = self.facts.steps
        steps = np.rint(samples.heads_deg * (of / 360.0)).astype(np.int64) % of
        rows = zip(
            samples.times_ns.tolist(), steps.tolist(), samples.ranges_mm.tolist(), strict=True
        )
        for time_ns, step, range_mm in rows:
            is_first = step % self._per_packet == 0 or self.is_stuck
            if not self._ranges_mm and not is_first:
                continue  # a head that was stuck continues in the middle of a packet
            if not self._ranges_mm:
                self._index = step // self._per_packet
            self._ranges_mm.append(range_mm)
            if len(self._ranges_mm) == self._per_packet:
                self._send(time_ns, self._encode(self._index, samples.hz, self._ranges_mm))
                self._ranges_mm = []

    def _encode(self, index: int, hz: float, ranges_mm: list[int]) -> bytes:
        """Make a packet; `ranges_mm` is 0 where there is no range."""
        raise NotImplementedError
