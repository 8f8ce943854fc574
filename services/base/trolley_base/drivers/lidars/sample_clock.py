"""When samples were measured, from when their bytes arrived.

Bytes come late by what the line, USB (up to 16 ms) and threads add, never early. So the time of a
sample is the sensor's own time plus the least lateness seen: a lower envelope, which creeps upward
so that it follows a sensor whose clock is slow.
"""

import math

from trolley_base.units import NS_PER_S

DRIFT = 0.003
"""How wrong a sensor's clock may be, as a share; crystals and motors stay within this."""
WINDOW_S = 0.5
"""If everything in this time [s] came later than expected, the expectation is corrected."""
GAP_NS = 60_000_000
"""Later than expected by this much [ns] means that data was lost; less than the shortest turn."""


class SampleClock:
    """Maps a sensor's time [s], which only grows, to robot time [ns]."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        self._least_late_ns = math.inf
        self._updated_s = self._window_began_s = 0.0

    def update(self, sensor_s: float, lead_ns: int) -> bool:
        """Take that a sample cannot have been measured later than it arrived.

        Args:
            sensor_s: the sensor's time of the newest sample.
            lead_ns: robot time minus sensor time as the arrival shows it.

        Returns:
            False where so much time is missing that samples must have been lost.
        """
        elapsed_s, self._updated_s = sensor_s - self._updated_s, sensor_s
        if self._offset_ns is None or lead_ns > self._offset_ns + GAP_NS:
            is_first = self._offset_ns is None
            self._offset_ns = lead_ns
            self._begin_window(sensor_s)
            return is_first
        crept = self._offset_ns + round(DRIFT * max(elapsed_s, 0.0) * NS_PER_S)
        self._offset_ns = min(crept, lead_ns)
        self._least_late_ns = min(self._least_late_ns, lead_ns - self._offset_ns)
        if sensor_s - self._window_began_s >= WINDOW_S:
            self._offset_ns += round(self._least_late_ns)
            self._begin_window(sensor_s)
        return True

    def at(self, sensor_s: float) -> int:
        """Return robot time [ns] at a sensor's time [s], once something was heard."""
        return (self._offset_ns or 0) + round(sensor_s * NS_PER_S)

    def _begin_window(self, sensor_s: float) -> None:
        self._least_late_ns, self._window_began_s = math.inf, sensor_s
