"""The robot as an assistant's session sees it."""

from trolley.runtime.service import Service
from trolley_mcp.robot_link import RobotLink


class AssistantService(Service):
    """Asks the robot what an assistant wants to know or to be done.

    It watches nothing by itself: it asks when it is asked.
    """

    name = "mcp"

    def __init__(self) -> None:
        self.robot_link = RobotLink(self)
