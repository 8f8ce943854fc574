"""A simulated robot with a battery, in lock-step: the way home by all services together."""

import math

import pytest
from bench.harness.drives import CORRIDOR, KITCHEN, make_config, open_robot
from bench.harness.paths import WORLDS

from trolley import codes, requests, topics
from trolley.geometry import Pose2D
from trolley.messages import SavedPose, Stop, Tour
from trolley.messages.request_params import StartTour

START = Pose2D(0.549, 0.218, 0.2579)
REST = f"""
[base.simulated]
world = "{(WORLDS / "apartment.toml").resolve()}"
seed = 5
[base.simulated.battery]
fraction = 0.2
minutes = 10.0
charger = {{ x = {START.x}, y = {START.y}, yaw = {START.yaw} }}
"""


@pytest.mark.slow
def test_an_endless_tour_goes_home_charges_and_can_be_resumed() -> None:
    config = make_config(WORLDS / "apartment.yaml", START, REST)
    with open_robot(config, 5) as lockstep:
        truths, tours = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.TOUR)
        poses, bases = lockstep.record(topics.POSE), lockstep.record(topics.BASE)
        assert lockstep.run_until(lambda: bool(poses) and poses[-1].state == "localized", 30.0)
        home = SavedPose(name="home", map="apartment", pose=START)
        lockstep.ask(requests.POSES_PUT, home)
        stops = [Stop(pose=CORRIDOR), Stop(pose=KITCHEN)]
        lockstep.ask(requests.TOUR_START, StartTour(tour=Tour(stops=stops, repeat=0)))
        paused = lockstep.run_until(lambda: tours[-1].state == "paused", 1500.0)
        assert paused, tours[-1]
        assert tours[-1].reason == codes.LOW_BATTERY
        assert any("driving home" in status.message for status in tours)
        at = truths[-1].pose
        assert math.hypot(at.x - START.x, at.y - START.y) < 0.15
        assert truths[-1].collisions == 0
        battery = bases[-1].battery
        assert battery is not None
        assert (battery.charging, (battery.fraction or 1.0) < 0.3) == (True, True)
        lockstep.run(50.0)
        charged = bases[-1].battery
        assert charged is not None
        assert (charged.fraction or 0.0) > 0.4
        assert tours[-1].state == "paused"  # nothing sets off by itself
        lockstep.ask(requests.TOUR_RESUME)
        assert lockstep.run_until(lambda: tours[-1].state == "dwelling", 120.0), tours[-1]
