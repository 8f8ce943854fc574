"""The tab of the map: what has changed on it, its places and zones, and how one is made."""

from trolley import topics
from trolley_viz.controls.controls import Controls
from trolley_viz.panels.map_changes import ChangePanel
from trolley_viz.panels.map_editing import MapEditPanel
from trolley_viz.panels.mapping import MappingPanel
from trolley_viz.panels.places import PlacePanel
from trolley_viz.panels.zones import ZonePanel
from trolley_viz.robots.view import View
from trolley_viz.session.session import Session


class MapTab:
    """All about the map in one browser."""

    def __init__(self, gui: Controls, session: Session) -> None:
        self._changes = ChangePanel(gui, session)
        self._session = session
        self._places_folder = session.folder("Places", is_open=True)
        with self._places_folder:
            self._places = PlacePanel(gui, session)
        self._zones = ZonePanel(gui, session)
        self._mapping = MappingPanel(gui, session)
        self._map_edit = MapEditPanel(gui, session)

    def edit_place(self, name: str) -> None:
        """Let a place be changed."""
        self._places_folder.open()
        self._places.edit(name)

    def edit_zone(self, name: str) -> None:
        """Let a zone be changed."""
        self._zones.folder.open()
        self._session.zone_editor.select(name)

    def update(self, view: View) -> None:
        """Show what there is to choose, and what is under way."""
        self._changes.update(view.overdue_s(topics.CHANGES))
        self._places.update(view)
        self._zones.update()
        self._mapping.update(view)
        self._map_edit.update()
