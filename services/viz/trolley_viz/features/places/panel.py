"""The saved places: new ones, and what there is to change about those that are there."""

from trolley.messages import SavedPose
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.shared import show_undo
from trolley_viz.controls.undo import History
from trolley_viz.features.places.place_actions import PlaceActions
from trolley_viz.graphics.icons import known_icon
from trolley_viz.robots.view import View
from trolley_viz.scene.places import current_places

NEW = "+ new place"
"""No place can be called so: names hold no plus sign."""
ICONS: dict[str, str] = {
    "pin": "map-pin",
    "home": "home",
    "kitchen": "tools-kitchen-2",
    "living room": "sofa",
    "armchair": "armchair",
    "bedroom": "bed",
    "bathroom": "bath",
    "toilet": "toilet-paper",
    "laundry": "wash",
    "door": "door",
    "stairs": "stairs",
    "window": "window",
    "office": "device-desktop",
    "television": "device-tv",
    "books": "books",
    "music": "piano",
    "plants": "plant",
    "pets": "paw",
    "children": "baby-carriage",
    "mail": "mailbox",
    "rubbish": "trash",
    "coffee": "coffee",
    "charger": "battery-charging",
    "star": "star",
}
"""What people call the icons that are offered, with their names."""


class PlacePanel:
    """One form for a new place and for those that are saved."""

    def __init__(self, gui: Controls, places: PlaceActions, history: History) -> None:
        self._places, self._history = places, history
        self._stored: dict[str, SavedPose] = {}
        self._filled: SavedPose | None = None
        """What the fields were filled from."""
        self._next = ""
        """The place to be chosen as soon as it is listed."""
        self._place = gui.add_list("Place", (NEW,), words=(NEW,))
        self._name = gui.add_text("Name", "")
        self._icon = gui.add_list("Icon", tuple(ICONS), words=tuple(ICONS))
        self._note = gui.add_text("Note", "", visible=False)
        with gui.add_tiles():
            self._save = gui.add_button("Save changes", icon="device-floppy", colour="green")
            self._here = gui.add_button("Save where the robot is", icon="robot", colour="green")
            self._point = gui.add_button("Point on the map …", icon="map-pin", colour="teal")
            self._delete = gui.add_button("Delete", icon="trash")
            self._undo = gui.add_button("Undo", icon="arrow-back-up")
        self._place.on_change(self._choose)
        self._save.on_press(self._save_changes)
        self._here.on_press(self._save_here)
        self._point.on_press(self._point_out)
        self._delete.on_press(self._delete_chosen)
        self._undo.on_press(lambda: history.undo("place"))

    def update(self, view: View) -> None:
        """Show the places that there are; what another browser changes is shown here, too."""
        self._stored = {one.name: one for one in current_places(view)}
        self._place.options = [NEW, *sorted(self._stored, key=str.casefold)]
        if self._next in self._stored:
            self._place.value, self._next = self._next, ""
        chosen = self._stored.get(self._place.value)
        if chosen != self._filled:
            self._fill(chosen)
        is_new = chosen is None
        self._save.visible = self._delete.visible = self._note.visible = not is_new
        self._here.label = "Save where the robot is" if is_new else "Move to the robot"
        self._point.label = "Point on the map …" if is_new else "Move on the map …"
        show_undo(self._undo, self._history, "place")

    def edit(self, name: str) -> None:
        """Choose a place, to be changed."""
        if name in self._stored:
            self._place.value, self._next = name, ""

    # Inside.
    def _fill(self, place: SavedPose | None) -> None:
        """Put what is stored into the fields."""
        self._filled = place
        icon = "" if place is None else known_icon(place.icon) or ""
        called = next((called for called, name in ICONS.items() if name == icon), icon)
        self._icon.options = [*ICONS] if called in ICONS or not called else [*ICONS, called]
        self._icon.value = called or next(iter(ICONS))
        self._name.value = "" if place is None else place.name
        self._note.value = "" if place is None else place.note

    def _choose(self, name: str) -> None:
        self._next = ""
        self._fill(self._stored.get(name))

    def _chosen_icon(self) -> str:
        return ICONS.get(self._icon.value, self._icon.value)

    def _save_changes(self) -> None:
        place = self._filled
        if place is not None:
            self._next = self._name.value.strip()
            self._places.change(place, self._name.value, self._chosen_icon(), self._note.value)

    def _save_here(self) -> None:
        if self._filled is None:
            self._places.save_here(self._name.value, self._chosen_icon(), self._choose_next)
        else:
            self._places.move_here(self._filled)

    def _point_out(self) -> None:
        if self._filled is None:
            self._places.point_new(self._name.value, self._chosen_icon(), self._choose_next)
        else:
            self._places.point_move(self._filled)

    def _delete_chosen(self) -> None:
        if self._filled is not None:
            self._places.delete(self._filled)

    def _choose_next(self, name: str) -> None:
        """Empty the fields for the next new place."""
        del name
        self._fill(None)
