"""A map as it is saved: along its walls, and without what was seen through cracks."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.map_editing import angle_to_straighten
from trolley.slices import whole
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.slam.tidying import tidied

from .conftest import START, Drive

MakeDrive = Callable[..., Drive]


def drive_a_bit(drive: Drive) -> None:
    drive.scan()
    for _ in range(25):
        drive.scan(0.5, 0.1)


@pytest.mark.drives
def test_a_new_map_is_turned_along_its_walls_with_all_that_lies_on_it(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive(Mapper(MapperConfig()))
    drive_a_bit(drive)
    mapper = drive.mapper
    place = mapper.anchor(Pose2D(1.0, 0.5, 0.2))
    true_place = START @ mapper.moved(place)
    lag = mapper.take_job()  # begun before, ended after
    job = mapper.finishing()
    for _ in range(6):
        drive.scan(0.5, 0.1)  # the robot drives on meanwhile
    job.run()
    before = drive.last
    assert before is not None
    motion = mapper.turn(job)
    if lag is not None:
        whole(lag.slices())
        mapper.finish(lag)

    # Cells tell the direction of a wall of 6 m to half a degree.
    assert abs(angle_to_straighten(job.grid)) < math.radians(1.0)
    assert abs(angle_to_straighten(mapper.grid())) < math.radians(1.0)
    assert job.start is not None
    assert (job.start.x, job.start.y) == (0.0, 0.0)
    left = math.remainder(job.start.yaw - START.yaw, math.pi / 2)
    assert abs(left) < math.radians(0.3)
    true_T_map = START @ job.start.inverse()
    assert (true_T_map @ motion @ before.pose).distance_to(drive.pose) < 0.03
    assert (true_T_map @ mapper.moved(place)).distance_to(true_place) < 0.01
    after = drive.scan(0.5, 0.0)
    assert after.state == "mapping"
    assert (true_T_map @ after.pose).distance_to(drive.pose) < 0.03
    # A mapper that is restored from what is stored then has it straight, too.
    assert abs(mapper.finishing().run().new_T_old.yaw) < math.radians(0.2)


@pytest.mark.drives
def test_an_extended_map_stays_as_it_lies(make_drive: MakeDrive, flat: GridMap) -> None:
    crooked = Pose2D(0.0, 0.0, 0.2)
    prior = GridMap("flat", flat.resolution, crooked, flat.cells)
    drive = make_drive(Mapper(MapperConfig(), crooked @ START, prior))
    drive_a_bit(drive)
    job = drive.mapper.finishing().run()
    assert job.new_T_old == Pose2D.identity()
    assert job.occupancy is None
    assert job.start is None
    assert drive.mapper.turn(job) == Pose2D.identity()
    assert (job.grid.cells == FREE).sum() == (drive.mapper.grid().cells == FREE).sum()


def walls(*lines: tuple[tuple[float, float], tuple[float, float]]) -> GridMap:
    """A map of thin walls between places [m]."""
    cells = np.full((400, 400), UNKNOWN, np.int8)
    for one, other in lines:
        count = 40 * math.ceil(math.dist(one, other)) + 1
        at = np.linspace(one, other, count) / 0.05 + 200
        cells[at[:, 1].astype(int), at[:, 0].astype(int)] = OCCUPIED
    return GridMap("walls", 0.05, Pose2D.identity(), cells)


def wing(length: float, angle: float, at: Pose2D) -> list:
    """The walls of a wing with rooms, 4 m wide."""
    frame = at @ Pose2D(0.0, 0.0, angle)
    local = [((0.0, y), (length, y)) for y in (0.0, 4.0)]
    local += [((x, 0.0), (x, 3.0)) for x in np.arange(0.0, length + 0.1, 3.0)]
    return [tuple(map(tuple, frame.transform_points(np.array(line)).tolist())) for line in local]


def test_of_two_wings_the_longer_lies_along_the_axes() -> None:
    long, short = math.radians(10.0), math.radians(55.0)
    grid = walls(
        *wing(9.0, long, Pose2D(-8.0, -6.0, 0.0)), *wing(6.0, short, Pose2D(2.0, 0.0, 0.0))
    )
    assert angle_to_straighten(grid) == pytest.approx(-long, abs=math.radians(0.3))


def test_a_round_hall_is_left_as_it_lies() -> None:
    y, x = np.indices((220, 220)) - 110
    cells = np.full((220, 220), FREE, np.int8)
    cells[np.abs(np.hypot(x, y) - 95) < 1.0] = OCCUPIED
    cells[80, 60:75] = cells[140:150, 120] = OCCUPIED  # a shelf, and another
    assert angle_to_straighten(GridMap("hall", 0.05, Pose2D.identity(), cells)) == 0.0


def test_floor_seen_through_a_crack_goes_and_through_a_door_stays() -> None:
    cells = np.full((100, 200), UNKNOWN, np.int8)
    cells[10:90, 10:80] = FREE
    cells[10:90, [9, 80]] = cells[[9, 90], 9:81] = OCCUPIED
    cells[20:36, 80] = FREE  # a door of 0.8 m
    cells[15:41, 81:160] = FREE
    cells[60:63, 80] = FREE  # a crack of 0.15 m
    for col in range(81, 160):
        spread = (col - 80) // 8
        cells[60 - spread : 63 + spread, col] = FREE
    cells[55:70, 160] = OCCUPIED
    grid = GridMap("flat", 0.05, Pose2D(-1.0, 2.0, 0.0), cells)
    found = whole(tidied(grid, grid.cell_to_world(np.array([[50, 40], [52, 44]]))))
    room, door = np.s_[10:90, 10:80], np.s_[15:41, 81:160]
    assert (found.cells[room] == cells[room]).all()
    assert (found.cells[door] == FREE).all()
    assert (found.cells[50:73, 88:160] == UNKNOWN).all()
    assert (found.cells == OCCUPIED).sum() == (cells == OCCUPIED).sum()


def test_where_nothing_was_driven_nothing_is_tidied() -> None:
    grid = GridMap("flat", 0.05, Pose2D.identity(), np.full((20, 20), FREE, np.int8))
    assert whole(tidied(grid, np.empty((0, 2)))) is grid
    assert whole(tidied(grid, np.array([[50.0, 50.0]]))) is grid
