"""All robots of the network: what each is doing, which one is followed, and Stop for all."""

from collections.abc import Callable, Mapping, Sequence

from trolley import topics
from trolley_viz.controls.controls import Button, Controls, Html
from trolley_viz.controls.markup import row
from trolley_viz.controls.shared import AddFolder
from trolley_viz.robots.fleet import IS_AWAY, Member
from trolley_viz.words.sentences import (
    StatusLine,
    aged,
    away_line,
    base_line,
    goal_line,
    percent,
    position_line,
    with_age,
)


class RobotsPanel:
    """A list to choose from, a line and a button for each; nothing where there is only one."""

    def __init__(
        self,
        gui: Controls,
        folder: AddFolder,
        follow: Callable[[str], None],
        stop_all: Callable[[], None],
    ) -> None:
        self._gui = gui
        self._follow = follow
        self._names: Mapping[str, str] = {}
        """By what they are called in the list."""
        self._rows: dict[str, tuple[Html, Button]] = {}
        self._choice = gui.add_list("Robot", (), words=(), visible=False)
        self._choice.on_change(lambda label: follow(self._names[label]))
        self._folder = folder("All robots")
        self._folder.visible = False
        with self._folder:
            stop = gui.add_button("Stop all robots", icon="hand-stop", colour="red")
        stop.on_press(stop_all)

    def update(self, members: Sequence[Member], labels: Mapping[str, str], followed: str) -> None:
        """Show what each is doing.

        Args:
            members: all robots, where there are several.
            labels: what to call each in the list, to its name.
            followed: the name of the one that is followed.
        """
        self._names = labels
        self._choice.options = [*labels]
        self._choice.set_words([label for label in labels if label.endswith(IS_AWAY)])
        self._choice.value = next(label for label, name in labels.items() if name == followed)
        self._choice.visible = len(labels) > 1
        self._folder.visible = bool(members)
        if list(self._rows) != [one.name for one in members]:
            for line, button in self._rows.values():
                line.remove()
                button.remove()
            with self._folder:
                self._rows = {one.name: self._add(one) for one in members}
        for one in members:
            line, button = self._rows[one.name]
            line.content = row(member_line(one))
            button.visible = one.name != followed

    def _add(self, member: Member) -> tuple[Html, Button]:
        line = self._gui.add_html("")
        button = self._gui.add_button(f"Follow {title_of(member)}", icon="eye")
        button.on_press(lambda: self._follow(member.name))
        return line, button


def title_of(member: Member) -> str:
    """What to call a robot."""
    robot = member.robot
    return robot.title or member.name if robot is not None else member.name


def member_line(member: Member) -> StatusLine:
    """Say in one line what a robot is doing, the most pressing thing first."""
    if member.robot_ns is None:
        words = away_line(member.away_s)
    else:
        estimate = member.pose
        position = position_line(estimate, member.pose_age_s)
        held = base_line(member.base)
        held = None if held is None else aged(held, member.ages.get(topics.BASE.name))
        trouble = held or (position if position.tone in ("bad", "warn") else None)
        goal = aged(goal_line(member.goal, []), member.ages.get(topics.GOAL.name))
        words = trouble or (position if estimate is None else goal)
    battery = None if member.base is None or member.is_away else member.base.battery
    charge = "" if battery is None or battery.fraction is None else percent(battery.fraction)
    charge = charge and f"Battery {charge}."
    base_age_s = member.ages.get(topics.BASE.name)
    if charge and base_age_s is not None:
        charge = f"{with_age(charge, base_age_s)}."
    detail = " ".join(part for part in (words.detail, charge) if part)
    return StatusLine(f"{title_of(member)}: {words.headline}", words.tone, detail)
