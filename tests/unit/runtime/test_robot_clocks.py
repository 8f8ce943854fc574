"""The clocks of several robots."""

import gc

from trolley.messages import Clock
from trolley.runtime.robot_time import FollowedTime, RobotClocks


def test_the_epoch_of_a_made_up_robot_costs_no_memory() -> None:
    def count() -> int:
        gc.collect()
        return sum(isinstance(one, FollowedTime) for one in gc.get_objects())

    clocks = RobotClocks("one")
    clocks.followed("two").update(Clock(stamp_ns=9, rate=1.0, epoch=5), 1)
    assert [clocks.epoch_of(name) for name in ("one", "two")] == [0, 5]
    before = count()
    assert {clocks.epoch_of(f"made-up-{number}") for number in range(1000)} == {0}
    assert count() == before
