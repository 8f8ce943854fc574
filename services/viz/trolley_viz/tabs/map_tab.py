"""The tab of the map: what has changed on it, its places and zones, and how one is made."""

from trolley import topics
from trolley_viz.controls.controls import Container, Controls
from trolley_viz.features.map_changes.panel import ChangePanel
from trolley_viz.features.map_editing.panel import MapEditPanel
from trolley_viz.features.mapping.panel import MappingPanel
from trolley_viz.features.places.panel import PlacePanel
from trolley_viz.features.zones.panel import ZonePanel
from trolley_viz.robots.view import View
from trolley_viz.session.session import Session


class MapTab:
    """All about the map in one browser."""

    def __init__(self, gui: Controls, tab: Container, session: Session) -> None:
        self.tab = tab
        folder, drawing, history = session.folder, session.drawing, session.actions.history
        editor = drawing.zone_editor
        self._changes = ChangePanel(
            gui,
            session.change_marks,
            session.change_requests,
            session.put_off,
            history,
        )
        self._select_zone = editor.select
        self._places_folder = folder("Places", is_open=True)
        with self._places_folder:
            self._places = PlacePanel(gui, session.place_actions, history)
        self._zones = ZonePanel(
            gui, folder, editor, session.suspected_mirrors, session.dismiss, history
        )
        self._mapping = MappingPanel(gui, folder, session.actions, session.aiming)
        self._map_edit = MapEditPanel(gui, folder, drawing.map_editor)

    def edit_place(self, name: str) -> None:
        """Let a place be changed."""
        self._places_folder.open()
        self._places.edit(name)

    def edit_zone(self, name: str) -> None:
        """Let a zone be changed."""
        self._zones.folder.open()
        self._select_zone(name)

    def update(self, view: View) -> None:
        """Show what there is to choose, and what is under way."""
        self._changes.update(view.overdue_s(topics.CHANGES))
        self._places.update(view)
        self._zones.update()
        self._mapping.update(view)
        self._map_edit.update()
