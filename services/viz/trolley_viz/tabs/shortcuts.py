"""Keys and the list of commands: what can be done without a mouse."""

import math
from collections.abc import Callable

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, table
from trolley_viz.session.session import Session

STEP_M, STEP_RAD = 0.1, math.radians(15.0)
"""How far an arrow key moves what is pointed at, or turns it."""
POINTING = [
    ("← ↑ → ↓", "While you point on the map: move the point, starting at the robot"),
    ("⇧← ⇧→", "Turn the point"),
    ("Enter", "Take the point"),
]


def add_shortcuts(gui: Controls, session: Session) -> str:
    """Listen to an operator's keys; returns the list of all keys as HTML.

    Those of Stop, the joystick and the list of commands are the page's own.
    """
    letters = gui.add_check("Letter keys", session.preferences.has_letters)
    letters.on_change(lambda is_on: session.preferences.switch_letters(is_on=is_on))
    actions, aiming = session.actions, session.aiming
    commands: list[tuple[str, str, Callable[[], None]]] = [
        ("Go to …", "g", aiming.point_goal),
        ("Set pose …", "p", aiming.point_pose),
        ("Cancel pointing or drawing", "escape", session.put_tools_away),
        ("Find position", "f", actions.find),
        ("Pause", "h", lambda: actions.steer("Pause")),
        ("Continue", "o", lambda: actions.steer("Continue")),
        ("Cancel", "x", lambda: actions.steer("Cancel")),
        ("Undo", "u", actions.history.undo),
        ("Show the whole map", "v", session.window.fit),
    ]
    steps = [
        ("Move the point up", "↑", lambda: session.step_cursor(0.0, STEP_M)),
        ("Move the point down", "↓", lambda: session.step_cursor(0.0, -STEP_M)),
        ("Move the point left", "←", lambda: session.step_cursor(-STEP_M, 0.0)),
        ("Move the point right", "→", lambda: session.step_cursor(STEP_M, 0.0)),
        ("Turn the point left", "⇧←", lambda: session.step_cursor(0.0, 0.0, STEP_RAD)),
        ("Turn the point right", "⇧→", lambda: session.step_cursor(0.0, 0.0, -STEP_RAD)),
        ("Take the point", "⏎", session.pointing.take),
    ]
    rows = [("Space or Shift+S", "Stop the robot")]
    if session.may_drive:
        for title, key, act in commands:
            gui.add_command(title, key, act)
            rows.append((key.title(), title))
        for title, key, act in steps:
            gui.add_command(title, key, act)
        rows += POINTING
        rows.append(("J", "Drive by hand: open and close the joystick"))
    rows.append(("Ctrl+K", "Search all commands"))
    return (
        note("Without letter keys, only Space, Esc and Ctrl+K work.")
        + note("Keys do nothing while you are typing in a field.")
        + table(rows)
    )
