"""Map changes that the localizer proposes: drawn, and offered for confirmation in a browser."""

from collections.abc import Callable, Collection, Sequence
from functools import partial

import numpy as np
import viser
from msgspec.structs import replace
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.map_editing.proposals import first_that_fit, ops_of
from trolley.messages import EditMap, MapChange, MapEdited, TakeBack
from trolley.messages.request_params import Nothing, WhichChange
from trolley.names import free_name
from trolley.runtime.service import Service
from trolley_viz.controls.undo import Step
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.features.map_editing.requests import request_map_edit
from trolley_viz.features.zones.suspected_mirrors import dashes
from trolley_viz.pointing.picture import Picture
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import WALL_HEIGHT, Z_LABEL
from trolley_viz.scene.places import APPEARED_COLOUR, GONE_COLOUR
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import refusal

DASH_M, GAP_M = 0.08, 0.06


class ChangeMarks:
    """The proposals that have not been put off in this browser."""

    def __init__(self, picture: Picture) -> None:
        self._picture = picture
        self._nodes: list[viser.SceneNodeHandle] = []
        self._drawn: tuple[object, ...] = ()
        self._put_off: frozenset[tuple[str, str]] = frozenset()
        self.offered: list[MapChange] = []
        """The surest first."""

    def put_off(self, map_name: str, changes: Collection[MapChange]) -> None:
        """Do not offer some changes in this browser until it is opened again."""
        self._put_off |= {(map_name, one.id) for one in changes}

    def update(self, view: View, *, is_shown: bool) -> None:
        """Draw what changed."""
        message, grid = view.streams.latest(topics.CHANGES), view.map
        world_T_map = view.placement.world_T("map")
        scene, name = self._picture.scene, None if grid is None else grid.name
        inputs = (scene, message, name, self._put_off, is_shown)
        if inputs == self._drawn or world_T_map is None:
            return
        self._drawn = inputs
        self.remove()
        if message is None or grid is None or message.map != grid.name:
            return
        self.offered = [one for one in message.changes if (grid.name, one.id) not in self._put_off]
        if scene is None or not is_shown:
            return
        for change in self.offered:
            outline = world_T_map.transform_points(np.array(change.points))
            strokes = world_T_map.transform_points(np.array(change.strokes).reshape(-1, 2))
            self._draw(scene, change, outline, strokes.reshape(-1, 2, 2))

    def remove(self) -> None:
        """Take them out of the scene."""
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        self.offered = []

    def _draw(
        self,
        scene: viser.SceneApi,
        change: MapChange,
        outline: NDArray[np.float64],
        strokes: NDArray[np.float64],
    ) -> None:
        """Draw what has come in full, and what is gone hatched, with an outline about it."""
        came = change.kind == "appeared"
        colour = APPEARED_COLOUR if came else GONE_COLOUR
        z = WALL_HEIGHT + 0.02
        pieces = [dashes(np.vstack([outline, outline[:1]]), DASH_M, GAP_M, z)]
        pieces += [
            np.array([[(*start, z), (*end, z)]], np.float32)
            if came
            else dashes(np.array([start, end]), DASH_M, GAP_M, z)
            for start, end in strokes[:: 1 if came else 2].tolist()
        ]
        self._nodes += [
            scene.add_line_segments(
                f"/changes/{change.id}/lines", np.concatenate(pieces), colour, thickness=0.03
            ),
            scene.add_label(
                f"/changes/{change.id}/name",
                f"{change.id}?",
                position=(*outline.mean(axis=0).tolist(), Z_LABEL),
                anchor="bottom-center",
                depth_test=False,
            ),
        ]


class ChangeRequests:
    """Asks the robot to put proposals on the map, or not to make them again.

    Args:
        actions: asks the selected robot, and remembers what can be undone.
        robot: which that is.
        map_name: the name of its map; "" while that is not known.
    """

    def __init__(
        self,
        service: Service,
        actions: RobotActions,
        robot: Callable[[], str],
        map_name: Callable[[], str],
    ) -> None:
        self._service = service
        self._actions = actions
        self._robot = robot
        self._map_name = map_name
        self.is_busy = False
        """Whether an answer is awaited."""

    def accept(self, changes: Sequence[MapChange]) -> None:
        """Store a new version of the map with the changes; the old one is kept."""
        name = self._map_name()
        fitting = first_that_fit(changes)
        if not self.is_busy and name and fitting:
            edit = EditMap(name=name, ops=ops_of(fitting))
            self._edit(edit, self._robot(), may_rename=True)

    def dismiss(self, changes: Sequence[MapChange]) -> None:
        """Let the robot not propose the changes again."""
        for change in changes:
            self._actions.ask(requests.CHANGES_DISMISS, WhichChange(id=change.id), "Not remembered")

    def _edit(self, params: EditMap, robot: str, *, may_rename: bool) -> None:
        self.is_busy = True

        def finish(reply: MapEdited | Refused) -> None:
            self.is_busy = False
            if not isinstance(reply, Refused):
                self._actions.tell("The map was changed", said(reply.message), "good")
                if robot == self._robot():
                    self._remember(reply.name)
            elif may_rename and reply.code == codes.EXISTS:
                # The user's own file is never written: the changed map gets a name of its own.
                then = partial(self._rename, params, robot)
                self._service.request(requests.MAP_LIST, Nothing(), then, robot=robot)
            else:
                self._service.log.info("Refused", request="map/edit", code=reply.code)
                self._actions.tell("The map was not changed", refusal(reply), "bad")

        request_map_edit(self._service, params, finish, robot)

    def _rename(self, params: EditMap, robot: str, names: list[str] | Refused) -> None:
        if isinstance(names, Refused):
            self._actions.tell("The map was not changed", refusal(names), "bad")
            return
        as_name = free_name(params.name, names)
        self._edit(replace(params, as_name=as_name), robot, may_rename=False)

    def _remember(self, name: str) -> None:
        """Let the person take it back, as long as the robot is on that map."""

        def undo() -> None:
            take_back = EditMap(name=name, ops=[TakeBack()])
            self._edit(take_back, self._robot(), may_rename=False)

        step = Step("map", f"Change the map {name}", undo, lambda: self._map_name() in ("", name))
        self._actions.history.add(step)
