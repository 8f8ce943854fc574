"""What people do to saved places; each can be taken back."""

from collections.abc import Callable

from msgspec import convert
from msgspec.structs import replace

from trolley import requests, topics
from trolley.geometry.frames import MAP
from trolley.messages import CapturedPose, SavedPose, Tour
from trolley.messages.request_params import Capture
from trolley_viz.controls.undo import Change
from trolley_viz.features.driving.aiming import Aiming, ignore
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.features.driving.stored_things import StoredThings
from trolley_viz.pointing.pointer import Pointed, Tool
from trolley_viz.robots.view import View

PLACE = "place"
PLACE_HINT = "Press where “{name}” is, drag the way the robot should face there, and release."


class PlaceActions:
    """Requests about saved places on behalf of one browser."""

    def __init__(self, actions: RobotActions, aiming: Aiming, view: Callable[[], View]) -> None:
        self._actions = actions
        self._aiming = aiming
        self._view = view
        self._things = StoredThings(
            actions,
            "place",
            requests.POSES_PUT,
            requests.POSES_DELETE,
            self.stored,
            self._tours_led_on,
            also=[requests.POSE_CAPTURE],
        )

    def stored(self, name: str) -> SavedPose | None:
        """The saved place of a name."""
        saved = self._view().streams.latest(topics.POSES)
        return next((one for one in saved.poses if one.name == name), None) if saved else None

    def save_here(self, name: str, icon: str, done: Callable[[str], None]) -> None:
        """Save where the robot stands under a new name."""
        if not (name := self._new_name(name)):
            return

        def saved(reply: CapturedPose) -> None:
            self._things.remember(f"Save “{name}”", Change(None, _place_of(reply)))
            self._saved(name, done)

        self._actions.ask(requests.POSE_CAPTURE, Capture(name=name, icon=icon), "Not saved", saved)

    def point_new(self, name: str, icon: str, done: Callable[[str], None]) -> None:
        """Let the person point out a new place on the map."""
        if not (name := self._new_name(name)):
            return

        def pointed_out(pointed: Pointed) -> None:
            pose = self._aiming.pose_at(pointed)
            self.put_new(SavedPose(name=name, pose=pose, icon=icon), done)

        self._point(name, pointed_out)

    def put_new(self, place: SavedPose, done: Callable[[str], None]) -> None:
        """Save a new place."""
        if name := self._new_name(place.name):
            change = Change(None, replace(place, name=name))
            title = f"Save “{name}”"
            self._things.change(title, change, "Not saved", lambda _: self._saved(name, done))

    def change(self, place: SavedPose, name: str, icon: str, note: str) -> None:
        """Give a place another name, icon or note; tours still find it."""
        name = name.strip()
        change = Change(place, replace(place, name=name, icon=icon, note=note))
        if name == place.name:
            self._things.change(f"Change “{name}”", change, "Not changed")
        elif self._new_name(name):
            self._things.change(f"Rename “{place.name}”", change, "Not renamed")

    def move_here(self, place: SavedPose) -> None:
        """Move a place to where the robot stands."""

        def captured(reply: CapturedPose, robot: str) -> None:
            # A capture knows no note: it is put back.
            change = Change(place, replace(_place_of(reply), note=place.note))
            self._things.change(title, change, "Its note was lost", robot=robot)

        def moved(reply: CapturedPose) -> None:
            self._things.remember(title, Change(place, _place_of(reply)))

        title = f"Move “{place.name}”"
        params = Capture(name=place.name, icon=place.icon, replace=True)
        done, then = (None, captured) if place.note else (moved, None)
        self._actions.ask(requests.POSE_CAPTURE, params, "Not moved", done, then)

    def point_move(self, place: SavedPose) -> None:
        """Let the person point out where a place should be."""

        def pointed_out(pointed: Pointed) -> None:
            pose = self._aiming.pose_at(pointed, place.pose.yaw)
            moved = replace(place, pose=pose, covariance=None, saved_at=None)
            self._things.change(f"Move “{place.name}”", Change(place, moved), "Not moved")

        self._point(place.name, pointed_out)

    def delete(self, place: SavedPose) -> None:
        """Forget a place."""

        def deleted(_: SavedPose) -> None:
            tours = [tour.name for tour in self._tours() if _stops_at(tour, place.name)]
            if tours:
                listed = ", ".join(f"“{name}”" for name in tours[:5])
                text = f"These tours stop there and can no longer find it: {listed}."
                self._actions.tell(f"“{place.name}” is gone", text, "warn")

        title = f"Delete “{place.name}”"
        self._things.change(title, Change(place, None), "Not deleted", deleted)

    # Inside.
    def _new_name(self, name: str) -> str:
        """The name without blanks around it; "" and a notice where it cannot be a new place's."""
        name = name.strip()
        if not name:
            self._actions.tell("Not saved", "Give the place a name first.", "warn")
            return ""
        if self.stored(name) is not None:
            text = f"There is already a place called “{name}”. Choose another name."
            self._actions.tell("Not saved", text, "warn")
            return ""
        return name

    def _saved(self, name: str, done: Callable[[str], None]) -> None:
        self._actions.tell("Saved", f"This place is now called “{name}”.", "good")
        done(name)

    def _point(self, name: str, done: Callable[[Pointed], None]) -> None:
        if self._view().placement.world != MAP:
            self._actions.tell("Not now", "There is no map to point at.", "warn")
            return

        def pointed_out(pointed: Pointed) -> None:
            self._aiming.put_away()
            done(pointed)

        self._aiming.arm(Tool(PLACE, ignore, pointed_out), PLACE_HINT.format(name=name))

    def _tours_led_on(self, before: SavedPose, after: SavedPose) -> list[Tour]:
        """The tours that stop at a place, with its new name."""
        tours = (tour for tour in self._tours() if _stops_at(tour, before.name))
        return [_led_to(tour, before.name, after.name) for tour in tours]

    def _tours(self) -> list[Tour]:
        tours = self._view().streams.latest(topics.TOURS)
        return [] if tours is None else tours.tours


def _stops_at(tour: Tour, name: str) -> bool:
    return any(stop.name == name for stop in tour.stops)


def _led_to(tour: Tour, old: str, new: str) -> Tour:
    """The tour with its stops renamed."""
    stops = [replace(stop, name=new) if stop.name == old else stop for stop in tour.stops]
    return replace(tour, stops=stops)


def _place_of(captured: CapturedPose) -> SavedPose:
    """What a capture stored."""
    return convert(captured, SavedPose, from_attributes=True)
