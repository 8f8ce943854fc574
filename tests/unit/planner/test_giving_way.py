"""Another robot on the way that does not go on, though it says that it has a goal."""

import msgspec
import numpy as np
import pytest
from support.flatland import Flatland, two_rooms, with_block

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, Path
from trolley.messages.types import floats_to_bytes

START = Pose2D(1.2, 3.0, 0.0)
IN_DOOR = Pose2D(4.0, 3.0, np.pi)
BACK = np.array([(4.0, 3.0, 0.0), (1.0, 3.0, 0.0)])


@pytest.mark.parametrize("own_name", ["z", "0"])
@pytest.mark.parametrize("names", [pytest.param("a", marks=pytest.mark.slow), "ab"])
def test_the_goal_ends_while_robots_with_goals_stand_in_the_door_for_ever(
    ride, own_name: str, names: str
) -> None:
    grid = two_rooms(0.7)
    world = Flatland(grid, START, truth=with_block(grid, 3.85, 2.88, 0.3, 0.25))
    drive = ride(world, PlannerConfig(give_up_s=6.0))
    neighbours = drive.navigator.neighbours
    neighbours.own_name = own_name
    path = Path(stamp_ns=0, frame="map", poses=floats_to_bytes(BACK), dt=0.0)

    def hear_of_them() -> bool:
        now_ns = drive.now_ns
        for index, name in enumerate(names):
            pose = Pose2D(IN_DOOR.x + 0.4 * index, IN_DOOR.y, IN_DOOR.yaw)
            estimate = msgspec.structs.replace(world.estimate(now_ns), pose=pose)
            neighbours.update_robot(world.robot(), name)
            neighbours.update_pose(estimate, name, now_ns)
            status = GoalStatus(stamp_ns=now_ns, id="x", state="driving", frame="map")
            neighbours.update_goal(status, name, now_ns)
            neighbours.update_path(msgspec.structs.replace(path, stamp_ns=now_ns), name)
        return not drive.navigator.current.board.is_active

    hear_of_them()
    drive.send(Pose2D(6.5, 3.0, 0.0))
    status = drive.until(hear_of_them, 120.0)
    assert (status.state, status.reason) == ("failed", codes.BLOCKED)
    assert "Robot " in status.message
