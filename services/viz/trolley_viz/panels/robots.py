"""All robots of the network: what each is doing, which one is followed, and Stop for all."""

from collections.abc import Callable, Sequence

import viser

from trolley_viz.panels.controls import STOP_RED, AddFolder, show
from trolley_viz.panels.markup import row
from trolley_viz.robots.fleet import Member
from trolley_viz.sentences import AWAY, StatusLine, base_line, goal_line, percent, position_line
from trolley_viz.threads import Post, handler


class RobotsPanel:
    """A line and a button for each robot; nothing where there is only one."""

    def __init__(
        self,
        gui: viser.GuiApi,
        folder: AddFolder,
        follow: Callable[[str], None],
        stop_all: Callable[[], None],
        post: Post,
    ) -> None:
        self._gui = gui
        self._follow = follow
        self._post = post
        self._folder = folder("All robots")
        self._folder.visible = False
        self._rows: dict[str, tuple[viser.GuiHtmlHandle, viser.GuiButtonHandle]] = {}
        with self._folder:
            stop = gui.add_button("Stop all robots", color=STOP_RED, icon=viser.Icon.HAND_STOP)
        stop.on_click(handler(post, lambda _, __: stop_all()))

    def update(self, members: Sequence[Member], followed: str) -> None:
        """Show what each is doing."""
        show(self._folder, visible=bool(members))
        if list(self._rows) != [one.name for one in members]:
            self._build(members)
        for one in members:
            line, button = self._rows[one.name]
            show(line, content=row(member_line(one)))
            show(button, visible=one.name != followed)

    def _build(self, members: Sequence[Member]) -> None:
        for line, button in self._rows.values():
            line.remove()
            button.remove()
        self._rows.clear()
        with self._folder:
            for one in members:
                line = self._gui.add_html("")
                button = self._gui.add_button(f"Follow {title_of(one)}", icon=viser.Icon.EYE)
                button.on_click(
                    handler(self._post, lambda _, __, name=one.name: self._follow(name))
                )
                self._rows[one.name] = line, button


def title_of(member: Member) -> str:
    """What to call a robot."""
    robot = member.robot
    return robot.title or member.name if robot is not None else member.name


def member_line(member: Member) -> StatusLine:
    """Say in one line what a robot is doing, the most pressing thing first."""
    if member.robot_ns is None:
        words = AWAY
    else:
        estimate = member.pose
        age_s = None if estimate is None else (member.robot_ns - estimate.stamp_ns) * 1e-9
        position = position_line(estimate, age_s)
        held = base_line(member.base)
        trouble = held or (position if position.tone in ("bad", "warn") else None)
        words = trouble or (position if estimate is None else goal_line(member.goal, []))
    battery = None if member.base is None or member.is_away else member.base.battery
    charge = "" if battery is None or battery.fraction is None else percent(battery.fraction)
    detail = " ".join(part for part in (words.detail, charge and f"Battery {charge}.") if part)
    return StatusLine(f"{title_of(member)}: {words.headline}", words.tone, detail)
