"""Compiles the world's kernels by simulating a moment with everything in it."""

import numpy as np

from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_base.world.scanner import Shots
from trolley_base.world.simulation import OtherRobot, RobotBody, Simulation
from trolley_base.world.spec import decode_world

WORLD = """
map = "warm-up.yaml"
start = { x = 0.0, y = 0.0, yaw = 0.0 }
circle = [{ x = 1.0, y = 0.0, radius_m = 0.1 }]
mirror = [{ points = [[-1.0, -1.0], [-1.0, 1.0]] }]
dull = [{ points = [[1.4, -1.0], [1.4, 1.0]] }]
person = [{ path = [[0.0, 1.0], [1.0, 1.0]] }]
"""


def warm_up() -> None:
    """Compile everything that a simulation calls."""
    cells = np.full((60, 60), FREE, dtype=np.int8)
    cells[0] = OCCUPIED
    grid = GridMap("warm-up", 0.05, Pose2D(-1.5, -1.5, 0.0), cells)
    footprint = np.array([[0.1, -0.1], [0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1]])
    robot = RobotBody(footprint, Pose2D.identity())
    simulation = Simulation(decode_world(WORLD, "warm-up.toml"), grid, robot, seed=0)
    simulation.set_others([OtherRobot("other", footprint + 1.2)])
    for _ in range(11):
        simulation.step(Twist2D(0.1, 0.0, 0.1))
    some = np.full(2, 0.5)
    simulation.measure(Pose2D.identity(), Shots(parts=some, bearings=some, draws=some, reach=1.0))
