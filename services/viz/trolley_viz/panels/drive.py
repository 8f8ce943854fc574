"""The tab to drive with: pointing, saved poses, the goal."""

from collections.abc import Sequence

import viser

from trolley.messages import GoalStatus, SavedPose
from trolley_viz.actions import GO_TO, SET_POSE, Actions
from trolley_viz.panels.control import GREEN, GREY, TEAL, Post, handler, set_options
from trolley_viz.pointing import Pointing
from trolley_viz.words import DRIVING

NO_PLACES: str = "none saved yet"
GOAL_ACTIONS = ("Pause", "Go on", "Cancel")
POINT_GOAL, POINT_POSE = "Go to …", "Set pose …"


class DrivePanel:
    """Buttons for one goal at a time."""

    def __init__(self, gui: viser.GuiApi, actions: Actions, pointing: Pointing, post: Post) -> None:
        self._goal: GoalStatus | None = None
        self._doomed: str | None = None
        """The place that the next press of Delete deletes."""
        self._go = gui.add_button(
            POINT_GOAL,
            icon=viser.Icon.MAP_PIN,
            color=GREEN,
            hint="Press where to go, drag to where the robot shall look, release. "
            "A plain click: any direction.",
        )
        self._set = gui.add_button(
            POINT_POSE,
            icon=viser.Icon.CURRENT_LOCATION,
            color=TEAL,
            hint="Press where the robot is, drag to where it looks, release. "
            "A plain click keeps its direction.",
        )
        self._find = gui.add_button(
            "Find yourself", icon=viser.Icon.SEARCH, color=GREY, hint="Search the whole map."
        )
        self._steer = gui.add_button_group("Goal", GOAL_ACTIONS)
        with gui.add_folder("Saved poses"):
            self._place = gui.add_dropdown("Place", (NO_PLACES,))
            self._go_place = gui.add_button("Go there", icon=viser.Icon.ARROW_RIGHT, color=GREEN)
            self._delete = gui.add_button("Delete it", icon=viser.Icon.TRASH, color=GREY)
        with gui.add_folder("Save where it is"):
            self._name = gui.add_text("Name", "")
            self._replace = gui.add_checkbox("Replace", False)
            self._save = gui.add_button("Save", icon=viser.Icon.DEVICE_FLOPPY)
        self._bind(actions, pointing, post)

    def update(
        self, goal: GoalStatus | None, places: Sequence[SavedPose], armed: str | None
    ) -> None:
        """Show what there is to choose; `armed` is the name of the tool that waits."""
        self._goal = goal
        names = sorted(one.name for one in places)
        set_options(self._place, names, NO_PLACES)
        self._go_place.disabled = self._delete.disabled = not names
        if self._doomed != self._place.value:
            self._doomed = None
        self._delete.label = f"Delete {self._doomed}? Press again" if self._doomed else "Delete it"
        self._steer.visible = goal is not None and goal.state in DRIVING
        self._go.label = "Press again to leave" if armed == GO_TO else POINT_GOAL
        self._set.label = "Press again to leave" if armed == SET_POSE else POINT_POSE

    def _bind(self, actions: Actions, pointing: Pointing, post: Post) -> None:
        self._go.on_click(handler(post, lambda _, __: actions.point_goal(pointing)))
        self._set.on_click(handler(post, lambda _, __: actions.point_pose(pointing)))
        self._find.on_click(handler(post, lambda _, __: actions.find()))
        self._steer.on_click(
            handler(post, lambda _, action: actions.steer_goal(action, self._goal))
        )
        self._go_place.on_click(handler(post, lambda _, __: actions.go_to_place(self._place.value)))
        self._delete.on_click(handler(post, lambda _, __: self._delete_chosen(actions)))
        self._save.on_click(
            handler(
                post,
                lambda _, __: actions.save_place(
                    self._name.value, replace=self._replace.value, saved=self._saved
                ),
            )
        )

    def _delete_chosen(self, actions: Actions) -> None:
        """Delete the chosen place at the second press; another choice in between counts as none."""
        chosen = self._place.value
        if self._doomed == chosen:
            actions.delete_place(chosen)
        self._doomed = None if self._doomed == chosen else chosen

    def _saved(self) -> None:
        """Empty the name after it was used."""
        self._name.value = ""
        self._replace.value = False
