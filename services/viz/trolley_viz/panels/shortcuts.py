"""Keys and the command palette: what can be done without a mouse.

viser listens to the keys in the page; it leaves alone those that are typed into a field.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import viser

from trolley_viz.panels.markup import note, table
from trolley_viz.session.session import Session

Key = Literal["escape", "G", "P", "F", "H", "O", "X", "U", "V"]


@dataclass(frozen=True)
class Shortcut:
    """A command with its key."""

    title: str
    key: Key
    icon: viser.IconName
    act: Callable[[], None]


def shortcuts(session: Session) -> list[Shortcut]:
    """Return what an operator can do with a key; Stop is everybody's, see `StopBar`."""
    actions, aiming = session.actions, session.aiming
    return [
        Shortcut("Go to …", "G", viser.Icon.MAP_PIN, aiming.point_goal),
        Shortcut("Set pose …", "P", viser.Icon.CURRENT_LOCATION, aiming.point_pose),
        Shortcut("Cancel pointing or drawing", "escape", viser.Icon.X, session.put_tools_away),
        Shortcut("Find position", "F", viser.Icon.SEARCH, actions.find),
        Shortcut("Pause", "H", viser.Icon.PLAYER_PAUSE, lambda: actions.steer("Pause")),
        Shortcut("Continue", "O", viser.Icon.PLAYER_PLAY, lambda: actions.steer("Continue")),
        Shortcut("Cancel", "X", viser.Icon.CIRCLE_X, lambda: actions.steer("Cancel")),
        Shortcut("Undo", "U", viser.Icon.ARROW_BACK_UP, actions.history.undo),
        Shortcut("Show the whole map", "V", viser.Icon.MAXIMIZE, session.fit_view),
    ]


def add_shortcuts(gui: viser.GuiApi, session: Session) -> str:
    """Listen to the keys; returns the list of them as HTML."""
    rows = [("Space or Shift+S", "Stop the robot")]
    if session.may_drive:
        for one in shortcuts(session):
            gui.add_command(one.title, hotkey=one.key, icon=one.icon).on_trigger(
                _trigger(session, one.act)
            )
            rows.append((one.key.title(), one.title))
        rows.append(("J", "Drive by hand: open and close the joystick"))
    rows.append(("Ctrl+K", "Search all commands"))
    return note("Keys do nothing while you are typing in a field.") + table(rows)


def _trigger(session: Session, act: Callable[[], None]) -> Callable[[Any], Any]:
    # async, and only handing over: this runs on the thread of the web server.
    async def trigger(_: Any) -> None:
        session.post(act)

    return trigger
