"""Who has the viewer open now, and what this browser is called."""

from trolley_viz.controls.controls import Controls, Text
from trolley_viz.controls.markup import note, row
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.people.names import NO_COOKIE
from trolley_viz.features.people.people import People, Present
from trolley_viz.robots.fleet import Robots
from trolley_viz.server.devices import A_BROWSER, HERE
from trolley_viz.server.visitors import Visitor
from trolley_viz.words.sentences import StatusLine, Tell, duration

MAX_ROWS = 30
UPDATE_NS = 1_000_000_000
"""How often the lines are brought up to date."""
ROLES = {"operator": "Drives", "viewer": "Looks only"}
HINT = "Such as “Anna's phone”: others see who sent the robot, and who stopped it."


class PeoplePanel:
    """A line for each open page, and the name of this one's browser.

    Args:
        people: at all pages.
        robots: that they may follow.
        number: of this page.
        visitor: who has it open.
    """

    def __init__(
        self,
        gui: Controls,
        add_folder: AddFolder,
        people: People,
        robots: Robots,
        number: int,
        visitor: Visitor,
        tell: Tell,
    ) -> None:
        self._people, self._robots, self._tell = people, robots, tell
        self._number, self._visitor = number, visitor
        self._due_ns = 0
        self._name: Text | None = None
        with add_folder("People"):
            self._rows = gui.add_html("")
            if not visitor.browser:
                gui.add_html(note(NO_COOKIE))
                return
            given = people.names.given(visitor)
            self._name = gui.add_text("Name of this browser", given, hint=HINT)
            # A name is asked for by itself: what is typed comes in pieces.
            save = gui.add_button("Use this name", icon="device-floppy")
        save.on_press(self._give)

    def update(self, now_ns: int) -> None:
        """Say who is there."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + UPDATE_NS
        present = self._people.present
        # This one is in front: among many it would be left out.
        present.sort(key=lambda one: one.number != self._number)
        lines = [row(self._line(one, now_ns), _given(one.name)) for one in present[:MAX_ROWS]]
        if len(present) > MAX_ROWS:
            lines.append(note(f"and {len(present) - MAX_ROWS} more"))
        self._rows.content = "".join(lines)

    def _line(self, one: Present, now_ns: int) -> StatusLine:
        robot = self._robots.get(one.robot)
        title = one.robot if robot is None else robot.title or one.robot
        is_this = one.number == self._number
        here = "This page. " if is_this else ""
        detail = f"{here}{ROLES[one.role]}. {_age(now_ns - one.since_ns)}. Follows {title}."
        return StatusLine(one.name, "good" if is_this else "idle", detail)

    def _give(self) -> None:
        field = self._name
        if field is None:
            return
        names, visitor = self._people.names, self._visitor
        why = names.give(visitor, field.value)
        if why:
            self._tell("Not saved", why, "warn")
            return
        field.value = names.given(visitor)
        self._due_ns = 0
        self._tell("Saved", f"This browser is called {names.of(visitor)}.", "good")


def _given(name: str) -> list[str]:
    """The name, if it is one, and not what the page says for want of one."""
    return [] if name in (HERE, A_BROWSER) else [name]


def _age(open_ns: int) -> str:
    """Say how long a page has been open, coarsely, so that it does not change all the time."""
    minutes = int(open_ns * 1e-9) // 60
    if minutes < 2:
        return f"Open for {minutes} min" if minutes else "Just opened"
    return f"Open for {duration(60.0 * minutes)}"
