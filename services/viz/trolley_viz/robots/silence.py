"""Which services of a robot have fallen silent."""

from trolley import topics
from trolley.messages import Health
from trolley_viz.robots.view import View

SILENT_NS = 4_000_000_000
"""A service that says nothing of its health for so long is not running."""
AWAITED: tuple[str, ...] = ("localizer", "planner")
"""Those without which a robot does not drive by itself: missed also if never heard."""


class SilentServices:
    """Watches the services of the robot that is shown."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, str], tuple[Health | None, int]] = {}
        """By robot and service, and since when it is the newest (local monotonic [ns])."""

    def update(self, view: View) -> frozenset[str]:
        """Return those that have fallen silent, or were to be heard by now."""
        robot, now_ns = view.robot_name, view.now_ns
        for name in AWAITED:
            self._newest.setdefault((robot, name), (None, now_ns))
        for (name,), one in view.streams.by_parts(topics.HEALTH).items():
            newest, _ = self._newest.get((robot, name), (None, now_ns))
            if newest is not one:
                self._newest[robot, name] = (one, now_ns)
        return frozenset(
            name
            for (of, name), (_, since_ns) in self._newest.items()
            if of == robot and now_ns - since_ns > SILENT_NS
        )
