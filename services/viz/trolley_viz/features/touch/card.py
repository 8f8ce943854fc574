"""The card of what was touched on the map: what it is, and what to do there."""

from collections.abc import Callable
from dataclasses import dataclass

from trolley import topics
from trolley.messages import Zone
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note
from trolley_viz.features.touch.touched import Touched
from trolley_viz.features.touch.touching import Touching
from trolley_viz.robots.view import View

KINDS = {
    "mirror": "Mirror",
    "glass": "Glass",
    "keepout": "The robot does not drive in here.",
    "speed": "The robot drives slowly here.",
    "room": "This is a room.",
}
FLOOR = "Here"


@dataclass(frozen=True)
class Leads:
    """Where a card leads: to other panels of the page, and to what it is about."""

    edit_place: Callable[[str], None]
    edit_zone: Callable[[str], None]
    add_to_tour: Callable[[Touched], None]
    follow_robot: Callable[[str], None]
    look_at: Callable[[float, float], None]


class TouchCard:
    """The card over the map, for people who may drive.

    Args:
        touching: what is touched.
        leads: away from the card.
    """

    def __init__(self, gui: Controls, touching: Touching, leads: Leads) -> None:
        self._touching, self._leads = touching, leads
        self._shown: Touched | None = None
        self._card = gui.add_card(of_spot=True)
        self._card.on_close(self._touching.close)
        with self._card:
            self._about = gui.add_html("")
            self._name = gui.add_text("Name", "", hint="To save this as a place")
            with gui.add_tiles():
                self._go = gui.add_button("Go", icon="map-pin", colour="green")
                self._save = gui.add_button("Save place", icon="device-floppy", colour="purple")
                self._tour = gui.add_button("Add to tour", icon="route", colour="teal")
                self._edit = gui.add_button("Edit", icon="pencil")
                self._pose = gui.add_button("The robot is here", icon="current-location")
                self._show = gui.add_button("Show this robot", icon="robot", colour="teal")
                self._follow_person = gui.add_button("Follow who is here", icon="walk")
                self._closer = gui.add_button("Look closer", icon="zoom-in")
        self._go.on_press(self._touching.go)
        self._save.on_press(lambda: self._touching.save(self._name.value))
        self._tour.on_press(self._add_to_tour)
        self._edit.on_press(self._open_editor)
        self._pose.on_press(self._touching.set_pose)
        self._show.on_press(self._follow)
        self._follow_person.on_press(self._touching.follow)
        self._closer.on_press(self._look_closer)

    def update(self, view: View) -> None:
        """Show what is touched."""
        one = self._touching.touched
        self._card.visible = one is not None
        if one is None:
            self._shown = None
            return
        if one != self._shown:
            self._shown = one
            self._name.value = ""
        is_here = one.what in ("place", "floor")
        is_other = one.what == "robot" and one.name != view.robot_name
        name = _title(view, one)
        self._card.call(name or FLOOR, is_name=bool(name))
        self._about.content = note(self._words(view, one))
        self._go.visible = self._tour.visible = is_here
        self._go.disabled = not view.can_go or self._touching.is_refused
        self._follow_person.visible = one.what == "floor"
        self._follow_person.disabled = not view.can_go
        self._name.visible = self._save.visible = self._pose.visible = one.what == "floor"
        self._edit.visible = one.what in ("place", "zone") or bool(one.room)
        self._show.visible = is_other

    # Inside.
    def _words(self, view: View, one: Touched) -> str:
        match one.what:
            case "robot":
                return "This robot." if one.name == view.robot_name else "Another robot."
            case "zone":
                zone = _zone(view, one.name)
                if zone is None:
                    return "It has been deleted."
                limit = "" if zone.speed is None else f" At most {zone.speed:.2f} m/s."
                return KINDS[zone.kind] + limit
            case _:
                return self._touching.way

    def _add_to_tour(self) -> None:
        one = self._touching.touched
        if one is not None:
            self._leads.add_to_tour(one)
            self._touching.close()

    def _open_editor(self) -> None:
        one = self._touching.touched
        if one is not None:
            lead = self._leads.edit_place if one.what == "place" else self._leads.edit_zone
            lead(one.name or one.room)
            self._touching.close()

    def _follow(self) -> None:
        one = self._touching.touched
        if one is not None:
            self._leads.follow_robot(one.name)

    def _look_closer(self) -> None:
        one = self._touching.touched
        if one is not None:
            self._leads.look_at(one.x, one.y)


def _title(view: View, one: Touched) -> str:
    """What a thing is called, "" for floor that is in no room."""
    if one.what != "robot":
        return one.name or one.room
    robots = {member.name: member.robot for member in view.fleet} | {view.robot_name: view.robot}
    robot = robots.get(one.name)
    return one.name if robot is None else robot.title or one.name


def _zone(view: View, name: str) -> Zone | None:
    zones = view.streams.latest(topics.ZONES)
    return next((one for one in zones.zones if one.name == name), None) if zones else None
