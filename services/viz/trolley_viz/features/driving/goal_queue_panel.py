"""Several places in a row: queued by pressing them, then driven one after the other."""

from trolley.messages import TourStatus
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, numbered
from trolley_viz.features.driving.aiming import QUEUE_GOALS, Aiming
from trolley_viz.features.driving.robot_actions import RobotActions

BEGIN, END = "Choose places …", "Done choosing"
HOW = "Press “Choose places …”, then the places in order, here or on the map."
CHOOSING = "Press places here or on the map, then press Start."


class GoalQueuePanel:
    """The list of queued goals, and the buttons to add, remove and start them."""

    def __init__(self, gui: Controls, actions: RobotActions, aiming: Aiming) -> None:
        self._actions, self._aiming = actions, aiming
        self._list = gui.add_html("")
        with gui.add_tiles():
            self._collect = gui.add_button(BEGIN, icon="list-numbers", colour="teal")
            self._start = gui.add_button("Start", icon="player-play", colour="green")
            self._back = gui.add_button("Remove last", icon="backspace")
            self._clear = gui.add_button("Clear", icon="trash")
        self._collect.on_press(self._toggle)
        self._start.on_press(self._set_off)
        self._back.on_press(actions.goal_queue.remove_last)
        self._clear.on_press(actions.goal_queue.clear)

    def update(self, trip: TourStatus | None, *, can: bool) -> None:
        """Show the queue; `can` says whether the robot would drive to its places."""
        goal_queue = self._actions.goal_queue
        goal_queue.follow(trip)
        how = CHOOSING if goal_queue.is_collecting else "" if goal_queue.items else HOW
        listed = numbered([one.title for one in goal_queue.items])
        self._list.content = (note(how) if how else "") + listed
        self._collect.label = END if goal_queue.is_collecting else BEGIN
        self._start.disabled = not goal_queue.items or not can
        self._back.disabled = not goal_queue.items or goal_queue.is_driven
        self._clear.disabled = not goal_queue.items

    def _toggle(self) -> None:
        goal_queue = self._actions.goal_queue
        goal_queue.collect(is_on=not goal_queue.is_collecting)
        if goal_queue.is_collecting:
            self._aiming.point_queue()
        elif self._aiming.armed == QUEUE_GOALS:
            self._aiming.put_away()

    def _set_off(self) -> None:
        self._aiming.put_away()
        self._actions.start_goal_queue()
