"""What one browser draws on the map: zones and changes of the map, one of them at a time."""

from collections.abc import Callable

from trolley_viz.features.driving.aiming import Aiming
from trolley_viz.features.map_editing.editor import MapEditor
from trolley_viz.features.zones.editor import ZoneEditor


class Drawing:
    """The tools that draw on the map, and what was drawn with them but not sent yet.

    Args:
        zone_editor: draws zones.
        map_editor: changes the map.
        aiming: points out goals, which ends when something is drawn.
    """

    def __init__(self, zone_editor: ZoneEditor, map_editor: MapEditor, aiming: Aiming) -> None:
        self.zone_editor = zone_editor
        self.map_editor = map_editor
        self._aiming = aiming
        self._put_aside: dict[str, Callable[[], None]] = {}
        """Takes up what is drawn on the map of a robot, by its name."""

    @property
    def hint(self) -> str:
        """What the chosen tool waits for, "" where there is none."""
        return self.zone_editor.hint or self.map_editor.hint

    def show(self) -> None:
        """Draw in a picture that is new."""
        self.zone_editor.show()
        self.map_editor.show()

    def hide(self) -> None:
        """Go without a picture."""
        self.zone_editor.hide()
        self.map_editor.hide()

    def update(self) -> None:
        """Bring what is drawn up to date."""
        self.zone_editor.update()
        self.map_editor.update()

    def begin_zone(self, robot: str) -> None:
        """Put away what else draws on the map: zones belong to the map that is stored."""
        self._aiming.put_away()
        self._put_map_aside(robot)

    def begin_map_tool(self) -> None:
        """Put away what else draws on the map."""
        self._aiming.put_away()
        self.zone_editor.leave()

    def yield_pointer(self) -> None:
        """Leave the pointer to what is pointed out."""
        if self.zone_editor.mode != "idle":
            self.zone_editor.leave()
        self.map_editor.choose("look")

    def put_away(self) -> None:
        """End all drawing."""
        self.zone_editor.leave()
        self.map_editor.choose("look")

    def put_aside(self, robot: str) -> None:
        """End all drawing on the map of a robot until `take_up`."""
        # First the map: a zone is drawn on the map that is stored.
        self._put_map_aside(robot)
        take_up = self.zone_editor.put_aside()
        if take_up is not None:
            self._put_aside.setdefault(robot, take_up)

    def take_up(self, robot: str) -> None:
        """Go on with what was put aside for a robot, unless a zone is drawn."""
        if self.zone_editor.mode == "idle":
            take_up = self._put_aside.pop(robot, None)
            if take_up is not None:
                take_up()

    def _put_map_aside(self, robot: str) -> None:
        """Leave the map editor; its steps so far come back later."""
        take_up = self.map_editor.put_aside()
        if take_up is not None:
            self._put_aside[robot] = take_up
