"""What all open browsers share."""

from collections.abc import Callable
from dataclasses import dataclass

import viser

from trolley import topics
from trolley.runtime.service import Service
from trolley_viz.features.past.keeper import Keeper
from trolley_viz.features.people.people import People
from trolley_viz.robots.fleet import Robots
from trolley_viz.robots.stop_presses import StopPresses
from trolley_viz.server.links import Links
from trolley_viz.server.visitors import Visitor
from trolley_viz.session.browser_store import BrowserStore
from trolley_viz.session.robot_scene import RobotScenes


@dataclass(frozen=True)
class Hub:
    """The parts of the viewer that the session of each browser uses."""

    service: Service
    """Asks the robots, and knows the time."""
    server: viser.ViserServer
    """Server of the scene."""
    robots: Robots
    """The robots of the network."""
    stops: StopPresses
    """The presses of Stop that are not answered yet."""
    scenes: RobotScenes
    """What is drawn of the robots."""
    browsers: BrowserStore
    """What was chosen in each browser."""
    let_go: Callable[[int], None]
    """Takes the joystick out of a page's hand."""
    past: Keeper
    """Records what the robots do."""
    people: People
    """Who has the viewer open, and who did what."""
    links: Links
    """Let others in: for operators only."""

    def press_stop(self, robot: str, visitor: Visitor) -> None:
        """Stop a robot, and note who did."""
        self.stops.press(robot, self.service.monotonic_ns)
        scene = self.scenes.by_robot.get(robot)
        if scene is not None:
            base = scene.streams.latest(topics.BASE)
            self.people.stoppers.press(robot, self.people.names.of(visitor), base)

    def is_open(self, client_id: int) -> bool:
        """Whether a browser is still connected; viser knows before it says that it is gone."""
        return client_id in self.server.get_clients()

    def robot_ns(self, robot: str) -> int | None:
        """The time of a robot [ns], None while its clock is silent."""
        return self.service.time_of(robot).now(self.service.monotonic_ns)
