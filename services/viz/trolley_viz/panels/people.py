"""Who has the viewer open now, and what this browser is called."""

from trolley_viz.controls.controls import Controls, Text
from trolley_viz.panels.markup import note, row
from trolley_viz.panels.more_tab import PERIOD_NS
from trolley_viz.people.names import NO_COOKIE
from trolley_viz.people.people import Present
from trolley_viz.sentences import StatusLine, duration
from trolley_viz.server.devices import A_BROWSER, HERE
from trolley_viz.session.session import Session

MAX_ROWS = 30
ROLES = {"operator": "Drives", "viewer": "Looks only"}
HINT = "Such as “Anna's phone”: others see who sent the robot, and who stopped it."


class PeoplePanel:
    """A line for each open page, and the name of this one's browser."""

    def __init__(self, gui: Controls, session: Session) -> None:
        self._session = session
        self._due_ns = 0
        self._name: Text | None = None
        with session.folder("People"):
            self._rows = gui.add_html("")
            if not session.visitor.browser:
                gui.add_html(note(NO_COOKIE))
                return
            given = session.hub.people.names.given(session.visitor)
            self._name = gui.add_text("Name of this browser", given, hint=HINT)
            # A name is asked for by itself: what is typed comes in pieces.
            save = gui.add_button("Use this name", icon="device-floppy")
        save.on_press(self._give)

    def update(self, now_ns: int) -> None:
        """Say who is there."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + PERIOD_NS
        present = self._session.hub.people.present
        # This one is in front: among many it would be left out.
        present.sort(key=lambda one: one.number != self._session.number)
        lines = [row(self._line(one, now_ns), _given(one.name)) for one in present[:MAX_ROWS]]
        if len(present) > MAX_ROWS:
            lines.append(note(f"and {len(present) - MAX_ROWS} more"))
        self._rows.content = "".join(lines)

    def _line(self, one: Present, now_ns: int) -> StatusLine:
        robot = self._session.hub.robots.get(one.robot)
        title = one.robot if robot is None else robot.title or one.robot
        is_this = one.number == self._session.number
        here = "This page. " if is_this else ""
        detail = f"{here}{ROLES[one.role]}. {_age(now_ns - one.since_ns)}. Follows {title}."
        return StatusLine(one.name, "good" if is_this else "idle", detail)

    def _give(self) -> None:
        session, field = self._session, self._name
        if field is None:
            return
        names = session.hub.people.names
        why = names.give(session.visitor, field.value)
        if why:
            session.tell("Not saved", why, "warn")
            return
        field.value = names.given(session.visitor)
        self._due_ns = 0
        session.tell("Saved", f"This browser is called {names.of(session.visitor)}.", "good")


def _given(name: str) -> list[str]:
    """The name, if it is one, and not what the page says for want of one."""
    return [] if name in (HERE, A_BROWSER) else [name]


def _age(open_ns: int) -> str:
    """Say how long a page has been open, coarsely, so that it does not change all the time."""
    minutes = int(open_ns * 1e-9) // 60
    if minutes < 2:
        return f"Open for {minutes} min" if minutes else "Just opened"
    return f"Open for {duration(60.0 * minutes)}"
