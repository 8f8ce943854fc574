"""The numbers of a trip."""

import dataclasses


@dataclasses.dataclass(frozen=True, slots=True)
class TripParams:
    """When a trip waits, asks again and gives up. All by hand; the first two can be configured."""

    stop_timeout_s: float = 300.0
    """Robot time of driving after which a stop counts as failed, where it says nothing itself."""
    retry_wait_s: float = 2.0
    """Wait before a failed stop is tried again; doubled at each failure."""
    longest_wait_s: float = 60.0
    """What doubled waits grow to at most."""
    lap_pause_s: float = 1.0
    """Between laps, so that a tour whose stops are all where the robot stands does not spin.

    Doubled with each lap in a row that reached nothing.
    """
    longest_step_s: float = 10.0
    """Robot time that counts at most between two ticks."""
    ask_again_s: float = 1.0
    """A goal that the planner has not accepted is sent again this often, a correction too."""
    silence_s: float = 2.0
    """The planner reports at 5 Hz; after this long it is asked whether it still drives."""

    def retry_wait_after(self, num_failures: int) -> float:
        """The wait [s] after so many failures in a row."""
        doubled_s = self.retry_wait_s * 2.0 ** min(num_failures - 1, 10)
        return min(doubled_s, max(self.longest_wait_s, self.retry_wait_s))

    def lap_pause_after(self, num_barren_laps: int) -> float:
        """The pause [s] after so many laps in a row that reached nothing."""
        return min(self.lap_pause_s * 2.0 ** min(num_barren_laps, 10), self.longest_wait_s)
