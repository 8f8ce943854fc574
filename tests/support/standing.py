"""Whether a robot that a hand let go of stands in time: judged by the robot's own clock."""

from support.waiting import wait_until
from trolley import topics
from trolley.client import Robot
from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.teleop import SOURCE

STANDS_WITHIN_S = 1.5
"""From the last command on: how old one may be, how long it holds, and braking."""


def stands(twist: Twist2D) -> bool:
    return twist.speed < 0.01 and abs(twist.wz) < 0.02


class HandDriven:
    """How a simulated robot really moves, and when a hand last told it to."""

    def __init__(self, robot: Robot) -> None:
        self._truth = robot.subscribe(topics.SIM_TRUTH)
        self._twist = Twist2D.zero()
        self._stands_since_ns: int | None = None
        self._last_ns = 0
        self._commanded_ns = 0
        self._closer = robot.connection.listen(topics.COMMAND.key(robot.name, SOURCE), self._hear)

    def close(self) -> None:
        self._truth.close()
        self._closer.close()

    def twist(self) -> Twist2D:
        """How the robot really moves."""
        while (arrival := self._truth.next(0.0)) is not None:
            self._twist, self._last_ns = arrival.message.twist, arrival.message.stamp_ns
            if not stands(self._twist):
                self._stands_since_ns = None
            elif self._stands_since_ns is None:
                self._stands_since_ns = arrival.message.stamp_ns
        return self._twist

    def wait_until_it_stands(self) -> None:
        """Wait, and judge by the robot's clock how long the last command moved it."""
        wait_until(lambda: stands(self.twist()) and self._stands_since_ns, "it stands")
        assert self._stands_since_ns is not None
        assert (self._stands_since_ns - self._commanded_ns) * 1e-9 < STANDS_WITHIN_S

    def keeps_standing(self, seconds: float) -> bool:
        """Watch it for so long by the robot's clock, and say whether it stood all the time."""
        self.twist()
        begun_ns = self._last_ns
        end_ns = begun_ns + round(seconds * 1e9)
        wait_until(lambda: self.twist() and self._last_ns >= end_ns, "the robot's time goes on")
        return self._stands_since_ns is not None and self._stands_since_ns <= begun_ns

    def _hear(self, sample: Sample) -> None:
        command = codec.decode(VelocityCommand, sample.payload, sample.encoding)
        if not command.twist.is_zero:
            self._commanded_ns = command.stamp_ns
