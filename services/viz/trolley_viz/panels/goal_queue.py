"""Several places in a row: queued by pressing them, then driven one after the other."""

import html

import viser

from trolley.messages import TourStatus
from trolley_viz.actions.aiming import GO_TO, Aiming
from trolley_viz.actions.robot_actions import RobotActions
from trolley_viz.panels.controls import GREEN, GREY, TEAL
from trolley_viz.panels.markup import note
from trolley_viz.panels.tiles import MARK, SMALL
from trolley_viz.threads import Post, handler

BEGIN, END = "Choose places …", "Done choosing"
HOW = "Press “Choose places …”, then the places in order, here or on the map."
CHOOSING = "Press places here or on the map, then press Start."


class GoalQueuePanel:
    """The list with its buttons."""

    def __init__(
        self, gui: viser.GuiApi, actions: RobotActions, aiming: Aiming, post: Post
    ) -> None:
        self._actions, self._aiming = actions, aiming
        goal_queue = actions.goal_queue
        gui.add_html(MARK + SMALL)
        self._list = gui.add_html("")
        self._collect = gui.add_button(BEGIN, icon=viser.Icon.LIST_NUMBERS, color=TEAL)
        self._start = gui.add_button("Start", icon=viser.Icon.PLAYER_PLAY, color=GREEN)
        self._back = gui.add_button("Remove last", icon=viser.Icon.BACKSPACE, color=GREY)
        self._clear = gui.add_button("Clear", icon=viser.Icon.TRASH, color=GREY)
        self._collect.on_click(handler(post, lambda _, __: self._toggle()))
        self._start.on_click(handler(post, lambda _, __: self._set_off()))
        self._back.on_click(handler(post, lambda _, __: goal_queue.remove_last()))
        self._clear.on_click(handler(post, lambda _, __: goal_queue.clear()))

    def update(self, trip: TourStatus | None) -> None:
        """Show the queue."""
        goal_queue = self._actions.goal_queue
        goal_queue.follow(trip)
        how = CHOOSING if goal_queue.is_collecting else "" if goal_queue.items else HOW
        rows = "".join(f"<li>{html.escape(one.title)}</li>" for one in goal_queue.items)
        listed = f'<ol style="margin:0.2em 0 0.6em;padding-left:2em">{rows}</ol>' if rows else ""
        self._list.content = (note(how) if how else "") + listed
        self._collect.label = END if goal_queue.is_collecting else BEGIN
        self._start.disabled = not goal_queue.items
        self._back.disabled = not goal_queue.items or goal_queue.is_driven
        self._clear.disabled = not goal_queue.items

    def _toggle(self) -> None:
        goal_queue = self._actions.goal_queue
        goal_queue.collect(is_on=not goal_queue.is_collecting)
        if goal_queue.is_collecting:
            self._aiming.point_goal()
        elif self._aiming.armed == GO_TO:
            self._aiming.put_away()

    def _set_off(self) -> None:
        self._aiming.put_away()
        self._actions.start_goal_queue()
