"""What people do to saved places; each can be taken back."""

from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from trolley import requests, topics
from trolley.geometry.frames import MAP
from trolley.messages import SavedPose, Tour
from trolley.messages.request_params import Capture, Named
from trolley_viz.controls.undo import Step
from trolley_viz.features.driving.aiming import Aiming, ignore
from trolley_viz.features.driving.robot_actions import RobotActions
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

    def stored(self, name: str) -> SavedPose | None:
        """The saved place of a name."""
        saved = self._view().streams.latest(topics.POSES)
        return next((one for one in saved.poses if one.name == name), None) if saved else None

    def save_here(self, name: str, icon: str, done: Callable[[str], None]) -> None:
        """Save where the robot stands under a new name."""
        if not (name := self._new_name(name)):
            return

        def saved(_: Any) -> None:
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
            self._put(replace(place, name=name), "Not saved", lambda _: self._saved(name, done))

    def change(self, place: SavedPose, name: str, icon: str, note: str) -> None:
        """Give a place another name, icon or note; tours still find it."""
        name = name.strip()
        if name == place.name:
            changed = replace(place, icon=icon, note=note)
            self._replace(place, changed, f"Change “{name}”", "Not changed")
        elif self._new_name(name):
            self._rename(place, replace(place, name=name, icon=icon, note=note), is_undo=False)

    def move_here(self, place: SavedPose) -> None:
        """Move a place to where the robot stands."""

        def captured(_: Any) -> None:
            # A capture knows no note: it is put back.
            now = self.stored(place.name)
            if place.note and now is not None:
                self._put(replace(now, note=place.note), "Its note was lost")
            self._remember(f"Move “{place.name}”", lambda: self._put(place, "Not moved back"))

        params = Capture(name=place.name, icon=place.icon, replace=True)
        self._actions.ask(requests.POSE_CAPTURE, params, "Not moved", captured)

    def point_move(self, place: SavedPose) -> None:
        """Let the person point out where a place should be."""

        def pointed_out(pointed: Pointed) -> None:
            pose = self._aiming.pose_at(pointed, place.pose.yaw)
            moved = replace(place, pose=pose, covariance=None, saved_at=None)
            self._replace(place, moved, f"Move “{place.name}”", "Not moved")

        self._point(place.name, pointed_out)

    def delete(self, place: SavedPose) -> None:
        """Forget a place."""

        def deleted(_: Any) -> None:
            self._remember(f"Delete “{place.name}”", lambda: self._put(place, "Not restored"))
            tours = [tour.name for tour in self._tours() if _stops_at(tour, place.name)]
            if tours:
                listed = ", ".join(f"“{name}”" for name in tours[:5])
                text = f"These tours stop there and can no longer find it: {listed}."
                self._actions.tell(f"“{place.name}” is gone", text, "warn")

        self._actions.ask(requests.POSES_DELETE, Named(name=place.name), "Not deleted", deleted)

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
        self._remember(
            f"Save “{name}”",
            lambda: self._actions.ask(requests.POSES_DELETE, Named(name=name), "Not deleted"),
        )
        done(name)

    def _point(self, name: str, done: Callable[[Pointed], None]) -> None:
        if self._view().placement.world != MAP:
            self._actions.tell("Not now", "There is no map to point at.", "warn")
            return

        def pointed_out(pointed: Pointed) -> None:
            self._aiming.put_away()
            done(pointed)

        self._aiming.arm(Tool(PLACE, ignore, pointed_out), PLACE_HINT.format(name=name))

    def _put(
        self, place: SavedPose, failed: str, done: Callable[[Any], None] | None = None
    ) -> None:
        self._actions.ask(requests.POSES_PUT, place, failed, done)

    def _replace(self, before: SavedPose, after: SavedPose, title: str, failed: str) -> None:
        def done(_: Any) -> None:
            self._remember(title, lambda: self._put(before, "Not changed back"))

        self._put(after, failed, done)

    def _rename(self, before: SavedPose, after: SavedPose, *, is_undo: bool) -> None:
        """Save it under the new name, point the tours there, and only then delete the old name."""

        def put(_: Any) -> None:
            for tour in self._tours():
                if _stops_at(tour, before.name):
                    led = _led_to(tour, before.name, after.name)
                    self._actions.ask(requests.TOURS_PUT, led, f"“{tour.name}” was not changed")
            old = Named(name=before.name)
            self._actions.ask(requests.POSES_DELETE, old, "The old name was not deleted", deleted)

        def deleted(_: Any) -> None:
            if not is_undo:
                self._remember(
                    f"Rename “{before.name}”", lambda: self._rename(after, before, is_undo=True)
                )

        self._put(after, "Not renamed", put)

    def _remember(self, title: str, undo: Callable[[], None]) -> None:
        self._actions.history.add(Step("place", title, undo))

    def _tours(self) -> list[Tour]:
        tours = self._view().streams.latest(topics.TOURS)
        return [] if tours is None else tours.tours


def _stops_at(tour: Tour, name: str) -> bool:
    return any(stop.name == name for stop in tour.stops)


def _led_to(tour: Tour, old: str, new: str) -> Tour:
    """The tour with its stops renamed."""
    stops = [replace(stop, name=new) if stop.name == old else stop for stop in tour.stops]
    return replace(tour, stops=stops)
