"""The controls of one page, as the panels build and read them.

What is set here is sent to the page when it has taken what was sent before: of what changes often
only the newest goes over a slow link. What is pressed there is called here, on the same thread.
"""

import itertools
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar, cast

from msgspec import structs

from trolley_viz.controls.messages import Colour, Command, ControlChanges, Kind, Look, Value
from trolley_viz.words.sentences import Tone

MAX_TEXT = 10_000
"""No person types more characters than that into a field."""
MAX_MOVE = 1000
"""No list on a page is longer."""

V = TypeVar("V", str, float, bool)
Act = Callable[[], None]


class NotThere(Exception):
    """What was pressed cannot be pressed any more."""


class BadValue(Exception):
    """A control has no such value: no page of ours sends it."""


class Control:
    """Anything on the page.

    Args:
        tree: what it belongs to.
        look: how it looks at first.
    """

    def __init__(self, tree: "Controls", look: Look) -> None:
        self._tree = tree
        self._look = look
        self.id = tree.take_id()
        tree.put(self)

    @property
    def look(self) -> Look:
        """How it looks."""
        return self._look

    def _change(self, **changed: Any) -> None:
        look = self._look
        # Panels set what is there already, again and again: a new look would be dear for that.
        for name, value in changed.items():
            if getattr(look, name) != value:
                self._look = structs.replace(look, **changed)
                self._tree.note(self)
                return

    def handle(self, value: Value) -> None:
        """Do what a press of it means; it is there and can be used.

        Raises:
            BadValue: It has no such value.
        """
        raise BadValue(f"a {self._look.kind} cannot be pressed")

    def remove(self) -> None:
        """Take it out of the page, with all that is in it."""
        self._tree.drop(self)

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return not self._look.is_hidden

    @visible.setter
    def visible(self, is_visible: bool) -> None:
        self._change(is_hidden=not is_visible)

    @property
    def disabled(self) -> bool:
        """Whether it can be seen but not used."""
        return self._look.is_disabled

    @disabled.setter
    def disabled(self, is_disabled: bool) -> None:
        self._change(is_disabled=is_disabled)

    @property
    def label(self) -> str:
        """What stands on it or before it."""
        return self._look.label

    @label.setter
    def label(self, label: str) -> None:
        self._change(label=label)

    @property
    def order(self) -> float:
        """Its place among its brothers, lowest first."""
        return self._look.order

    @order.setter
    def order(self, order: float) -> None:
        self._change(order=order)


class Html(Control):
    """Text with markup, made safe by whoever sets it."""

    _act: Callable[[str], None] | None = None

    def on_press(self, act: Callable[[str], None]) -> None:
        """Call `act` with the `data-press` of a button in it that is pressed."""
        self._act = act

    def handle(self, value: Value) -> None:
        """Press one of its buttons."""
        if self._act is None or not isinstance(value, str) or len(value) > MAX_TEXT:
            raise BadValue("no button of this text")
        self._act(value)

    @property
    def content(self) -> str:
        """The markup."""
        return self._look.content

    @content.setter
    def content(self, content: str) -> None:
        self._change(content=content)


class Button(Control):
    """Does one thing."""

    _act: Act | None = None
    _move: Callable[[int], None] | None = None

    def on_press(self, act: Act) -> None:
        """Call `act` when it is pressed."""
        self._act = act

    def on_move(self, move: Callable[[int], None]) -> None:
        """Let it be dragged among its like; `move` is called with by how many, up negative."""
        self._move = move
        self._change(can_move=True)

    def handle(self, value: Value) -> None:
        """Press it; a number moves it by so many places."""
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            if self._move is None or not float(value).is_integer() or abs(value) > MAX_MOVE:
                raise BadValue(f"{value!r} is no place in a list")
            self._move(int(value))
        elif self._act is not None:
            self._act()

    @property
    def icon(self) -> str:
        """A Tabler name."""
        return self._look.icon

    @icon.setter
    def icon(self, icon: str) -> None:
        self._change(icon=icon)

    @property
    def colour(self) -> Colour:
        """Says what it does."""
        return self._look.colour

    @colour.setter
    def colour(self, colour: Colour) -> None:
        self._change(colour=colour)


class Choice(Control):
    """A row of buttons, one of which is pressed at a time."""

    _act: Callable[[str], None] | None = None

    def on_press(self, act: Callable[[str], None]) -> None:
        """Call `act` with the option that is pressed."""
        self._act = act

    def turn_off(self, *options: str) -> None:
        """Let these be seen but not used, and all others be used."""
        self._change(off=options)

    def handle(self, value: Value) -> None:
        """Press one of its buttons."""
        if value not in self._look.options:
            raise BadValue(f"{value!r} is none of {', '.join(self._look.options)}")
        if value in self._look.off:
            raise NotThere
        if self._act is not None:
            self._act(value)


class Field(Control, Generic[V]):
    """Holds a value that a person may change."""

    _act: Callable[[V], None] | None = None

    @property
    def value(self) -> V:
        """What it holds."""
        return cast(V, self._look.value)

    @value.setter
    def value(self, value: V) -> None:
        self._change(value=value)

    def on_change(self, act: Callable[[V], None]) -> None:
        """Call `act` with the value that a person chose."""
        self._act = act

    def handle(self, value: Value) -> None:
        """Take a value from the page."""
        taken = self._checked(value)
        # The page shows what was typed; what was made of it it has to be told.
        self._look = structs.replace(self._look, value=taken)
        if taken != value:
            self._tree.note(self)
        if self._act is not None:
            self._act(taken)

    def _checked(self, value: Value) -> V:
        raise NotImplementedError


class Text(Field[str]):
    """A line of text."""

    def _checked(self, value: Value) -> str:
        if not isinstance(value, str) or len(value) > MAX_TEXT:
            raise BadValue("no text")
        return value


class Check(Field[bool]):
    """On or off."""

    def _checked(self, value: Value) -> bool:
        if not isinstance(value, bool):
            raise BadValue("neither on nor off")
        return value


class Hold(Control):
    """Says again and again that its page is in sight, as long as it is."""

    _act: Act | None = None

    def on_hold(self, act: Act) -> None:
        """Call `act` each time."""
        self._act = act

    def hear(self) -> None:
        """Hear it once more."""
        if self._act is not None:
            self._act()


class Number(Field[float]):
    """A number within bounds, typed or set by a slider."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing stands in it."""
        return self._look.value is None

    def set_range(self, least: float, greatest: float | None) -> None:
        """Allow numbers between these two only."""
        self._change(min=least, max=greatest)

    def _checked(self, value: Value) -> float:
        # Not isfinite: it breaks down on a whole number that no float can hold.
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not abs(value) <= sys.float_info.max
        ):
            raise BadValue("no number")
        least = -math.inf if self._look.min is None else self._look.min
        greatest = math.inf if self._look.max is None else self._look.max
        return min(max(float(value), least), greatest)


class Timeline(Number):
    """A slider over some time, with marks where something was."""

    def show(
        self, first_s: float, last_s: float, at_s: float, marks: Sequence[tuple[float, Tone]]
    ) -> None:
        """Show a time and some marks between two times of a day [s]."""
        self._change(min=first_s, max=last_s, value=at_s, marks=tuple(marks))


class List(Field[str]):
    """One of several, chosen from a list."""

    @property
    def options(self) -> tuple[str, ...]:
        """What there is to choose from."""
        return self._look.options

    @options.setter
    def options(self, options: Sequence[str]) -> None:
        chosen = self._look.value
        if chosen not in options:
            chosen = options[0] if options else ""
        self._change(options=tuple(options), value=chosen)

    def set_words(self, words: Sequence[str]) -> None:
        """Say which of its options are no names that people gave."""
        self._change(words=tuple(words))

    def _checked(self, value: Value) -> str:
        if not isinstance(value, str) or value not in self._look.options:
            raise BadValue("not in the list")
        return value


class Container(Control):
    """Holds other controls: those that are added while it is entered."""

    def __enter__(self) -> "Container":
        self._tree.enter(self.id)
        return self

    def __exit__(self, *_: object) -> None:
        self._tree.leave()

    def clear(self) -> None:
        """Take out all that is in it."""
        self._tree.empty(self)


class Folder(Container):
    """Controls that can be folded away, under a title; without a title they just stand together."""

    _act: Callable[[bool], None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether a person sees what is in it."""
        return self._look.is_open

    def open(self) -> None:
        """Open it on the page."""
        self._change(is_open=True)

    def on_fold(self, act: Callable[[bool], None]) -> None:
        """Call `act` with whether a person opened it."""
        self._act = act

    def handle(self, value: Value) -> None:
        """Open or close it."""
        if not isinstance(value, bool):
            raise BadValue("neither open nor closed")
        self._look = structs.replace(self._look, is_open=value)
        if self._act is not None:
            self._act(value)


class Card(Container):
    """Controls over the map, about one thing there, that can be closed."""

    _act: Act | None = None

    def call(self, title: str, *, is_name: bool) -> None:
        """Say what it is about, by a name that people gave or in our words."""
        self._change(label=title, is_name=is_name)

    def on_close(self, act: Act) -> None:
        """Call `act` when a person closes it."""
        self._act = act

    def handle(self, value: Value) -> None:
        """Close it."""
        if self._act is not None:
            self._act()


class Tabs(Control):
    """Folders of which one is seen at a time, at first the first."""

    _act: Act | None = None

    def on_open(self, act: Act) -> None:
        """Call `act` when a person opens another of them."""
        self._act = act

    def add_tab(self, title: str, icon: str) -> Container:
        """Add a tab, to be filled while it is entered."""
        tab = Container(self._tree, Look(kind="tab", parent=self.id, label=title, icon=icon))
        if self._look.value is None:
            self._look = structs.replace(self._look, value=tab.id)
        return tab

    def is_open(self, tab: Container) -> bool:
        """Whether one of them is seen on the page."""
        return self._look.value == tab.id

    def open(self, tab: Container) -> None:
        """Open one of them on the page."""
        self._change(value=tab.id)

    def handle(self, value: Value) -> None:
        """Open one of them."""
        if isinstance(value, bool) or value not in self._tree.inside(self.id):
            raise BadValue("none of the tabs")
        self._look = structs.replace(self._look, value=value)
        if self._act is not None:
            self._act()


class Controls:
    """All controls of one page."""

    def __init__(self) -> None:
        self._ids = itertools.count(1)
        self._controls: dict[int, Control] = {}
        self._commands: dict[int, Command] = {}
        self._inside: list[int] = []
        self._changed: set[int] = set()
        self._gone: set[int] = set()
        self._told: set[int] = set()
        """Those that the page knows; what changes where nobody looks it is told later."""
        self._has_new_commands = False

    # What the panels call.
    def add_html(self, content: str, *, visible: bool = True) -> Html:
        """Add text with markup."""
        return Html(self, self._look("html", visible, content=content))

    def add_button(
        self,
        label: str,
        *,
        icon: str = "",
        colour: Colour = "grey",
        is_name: bool = False,
        visible: bool = True,
    ) -> Button:
        """Add a button; its label may be a name that people gave."""
        look = self._look("button", visible, label=label, icon=icon, colour=colour)
        return Button(self, structs.replace(look, is_name=is_name))

    def add_hold(self) -> Hold:
        """Add what says that the page is in sight; nothing is seen of it."""
        return Hold(self, self._look("hold", True))

    def add_choice(self, label: str, options: Sequence[str], *, visible: bool = True) -> Choice:
        """Add a row of buttons."""
        return Choice(self, self._look("choice", visible, label=label, options=tuple(options)))

    def add_text(self, label: str, value: str, *, hint: str = "", visible: bool = True) -> Text:
        """Add a field for a line of text."""
        return Text(self, self._look("text", visible, label=label, value=value, hint=hint))

    def add_number(
        self,
        label: str,
        value: float | None,
        *,
        min: float | None = None,
        max: float | None = None,
        step: float | None = None,
        hint: str = "",
        visible: bool = True,
    ) -> Number:
        """Add a field for a number; with None nothing stands in it at first."""
        look = self._look("number", visible, label=label, value=value, hint=hint)
        return Number(self, structs.replace(look, min=min, max=max, step=step))

    def add_slider(
        self,
        label: str,
        value: float,
        *,
        min: float,
        max: float,
        step: float,
        visible: bool = True,
    ) -> Number:
        """Add a slider."""
        look = self._look("slider", visible, label=label, value=value)
        return Number(self, structs.replace(look, min=min, max=max, step=step))

    def add_timeline(self, label: str) -> Timeline:
        """Add a slider over some time."""
        look = self._look("timeline", True, label=label, value=0.0)
        return Timeline(self, structs.replace(look, min=0.0, max=0.0, step=1.0))

    def add_check(
        self,
        label: str,
        value: bool,
        *,
        hint: str = "",
        is_name: bool = False,
        visible: bool = True,
    ) -> Check:
        """Add a box that is ticked or not; its label may be a name that people gave."""
        look = self._look("check", visible, label=label, value=value, hint=hint)
        return Check(self, structs.replace(look, is_name=is_name))

    def add_list(
        self,
        label: str,
        options: Sequence[str],
        *,
        value: str | None = None,
        words: Sequence[str] | None = None,
        disabled: bool = False,
        visible: bool = True,
    ) -> List:
        """Add a list to choose from.

        Args:
            label: stands before it.
            options: what there is.
            value: what is chosen; None: the first.
            words: the options, now or later, that are no names that people gave; None: all.
            disabled: whether it can be seen but not used.
            visible: whether it is shown.
        """
        chosen = value if value is not None else options[0] if options else ""
        look = self._look("list", visible, label=label, options=tuple(options), value=chosen)
        own = None if words is None else tuple(words)
        return List(self, structs.replace(look, words=own, is_disabled=disabled))

    def add_folder(self, title: str = "", *, is_open: bool = False, visible: bool = True) -> Folder:
        """Add a folder, to be filled while it is entered."""
        return Folder(self, self._look("folder", visible, label=title, is_open=is_open))

    def add_tiles(self, *, visible: bool = True) -> Container:
        """Add a place for large buttons in two columns, to be filled while it is entered."""
        return Container(self, self._look("tiles", visible))

    def add_actions(self) -> Container:
        """Add a row that stays in view below an edit, to be filled while it is entered."""
        return Container(self, self._look("actions", True))

    def add_bar(self) -> Container:
        """Add a row of small buttons over the map, to be filled while it is entered."""
        return Container(self, self._look("bar", True))

    def add_strip(self) -> Container:
        """Add a strip along the lower edge of the map, to be filled while it is entered."""
        return Container(self, self._look("strip", False))

    def add_card(self, *, of_spot: bool = False) -> Card:
        """Add a card over the map, to be filled while it is entered.

        `of_spot`: it is about what was touched there, and leaves that in sight.
        """
        return Card(self, self._look("card", False, of_spot=of_spot))

    def add_tabs(self) -> Tabs:
        """Add a row of tabs."""
        return Tabs(self, self._look("tabs", True))

    def add_command(self, title: str, key: str, act: Act) -> Button:
        """Let a key do something; it is a button that is only in the list of commands."""
        button = Button(self, self._look("button", False, label=title))
        button.on_press(act)
        self._commands[button.id] = Command(id=button.id, title=title, key=key)
        self._has_new_commands = True
        return button

    # What there is.
    @property
    def all(self) -> Mapping[int, Control]:
        """All of them by their numbers, those too that are hidden."""
        return self._controls

    @property
    def commands(self) -> list[Command]:
        """What keys do."""
        return list(self._commands.values())

    # What the page's connection calls.
    def handle(self, control: int, value: Value) -> None:
        """Do what a press in the page means.

        Raises:
            NotThere: It is gone, hidden or disabled.
            BadValue: It has no such value.
        """
        found = self._controls.get(control)
        if found is None or not (control in self._commands or self._can_be_used(found)):
            raise NotThere
        found.handle(value)

    def hold(self, control: int) -> None:
        """Hear that the page of a `Hold` is in sight; it may be gone by now."""
        found = self._controls.get(control)
        if isinstance(found, Hold) and self._can_be_used(found):
            found.hear()

    def clear(self) -> None:
        """Take everything out of the page."""
        for control in list(self._controls.values()):
            self.drop(control)

    def forget_sent(self) -> None:
        """Send everything again, as to a page that has just been opened."""
        self._changed = set(self._controls)
        self._told.clear()
        self._gone.clear()
        self._has_new_commands = True

    def take_changes(self) -> ControlChanges | None:
        """Return what the page has not been told and is to see, None for nothing."""
        due = {id_ for id_ in self._changed if id_ not in self._told or self._is_in_sight(id_)}
        if not (due or self._gone or self._has_new_commands):
            return None
        looks = {id_: self._controls[id_].look for id_ in sorted(due)}
        commands = self.commands if self._has_new_commands else None
        changes = ControlChanges(looks=looks, gone=sorted(self._gone), commands=commands)
        self._told |= due
        self._changed -= due
        self._gone, self._has_new_commands = set(), False
        return changes

    # What the controls call.
    def take_id(self) -> int:
        """Return a number that no control has had."""
        return next(self._ids)

    def put(self, control: Control) -> None:
        """Take in a new control."""
        self._controls[control.id] = control
        self._changed.add(control.id)

    def note(self, control: Control) -> None:
        """Note that it has changed."""
        if control.id in self._controls:
            self._changed.add(control.id)

    def inside(self, parent: int) -> list[int]:
        """Return the numbers of what is in a container."""
        return [id_ for id_, one in self._controls.items() if one.look.parent == parent]

    def drop(self, control: Control) -> None:
        """Forget a control and all that is in it."""
        self.empty(control)
        if self._controls.pop(control.id, None) is not None:
            self._gone.add(control.id)
            self._changed.discard(control.id)
            self._told.discard(control.id)
            if self._commands.pop(control.id, None) is not None:
                self._has_new_commands = True

    def empty(self, control: Control) -> None:
        """Forget all that is in a control."""
        for inner in self.inside(control.id):
            self.drop(self._controls[inner])

    def enter(self, parent: int) -> None:
        """Add what comes next inside of this one."""
        self._inside.append(parent)

    def leave(self) -> None:
        """Add what comes next where it was added before."""
        self._inside.pop()

    # Inside.
    def _look(self, kind: Kind, visible: bool, **rest: Any) -> Look:
        parent = self._inside[-1] if self._inside else 0
        return Look(kind=kind, parent=parent, is_hidden=not visible, **rest)

    def _is_in_sight(self, id_: int) -> bool:
        """Whether nothing that a control is in is hidden, folded away or another tab than is open.

        The control itself may be hidden: that it is so now has to be told.
        """
        look = self._controls[id_].look
        while look.parent != 0:
            around = self._controls[look.parent].look
            is_folded = around.kind == "folder" and around.label != "" and not around.is_open
            is_behind = look.kind == "tab" and around.value != id_
            if around.is_hidden or is_folded or is_behind:
                return False
            id_, look = look.parent, around
        return True

    def _can_be_used(self, control: Control) -> bool:
        look: Look = control.look
        if look.is_disabled:
            return False
        while not look.is_hidden:
            if look.parent == 0:
                return True
            look = self._controls[look.parent].look
        return False
