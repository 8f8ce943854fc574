"""How a control looks, as the page is told; `frontend/controls.js` draws it."""

from typing import Literal

from msgspec import Struct

from trolley_viz.words.sentences import Tone

Kind = Literal[
    "actions",
    "bar",
    "button",
    "card",
    "choice",
    "check",
    "folder",
    "hold",
    "html",
    "list",
    "number",
    "slider",
    "strip",
    "tab",
    "tabs",
    "text",
    "tiles",
    "timeline",
]
Colour = Literal["grey", "green", "teal", "purple", "amber", "red"]
"""What a button does: red stops, green goes, amber pauses, purple is a place, teal a tour or tool,
grey the rest."""
Value = str | float | bool | None


class Look(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One control.

    Attributes:
        kind: what it is: `choice` is a row of buttons, `list` one to choose from, `tiles` holds
            large buttons in two columns, `actions` what ends an edit and why it cannot end yet;
            over the map, `bar` holds small ones, `card` what there is to one thing, and `strip`
            what goes along its lower edge. A `timeline` is a slider over times of a day [s],
            beginning at midnight. A `hold` is not seen: as long as the page is in sight, it says
            so every 0.2 s.
        parent: the folder or tab that it is in, 0 for the page.
        order: among its brothers, lowest first.
        label: what stands on it or before it.
        is_name: whether the label is a name that people gave: it is not translated.
        icon: a Tabler name.
        colour: of a button.
        is_hidden: whether it is left out.
        is_disabled: whether it can be seen but not used.
        can_move: whether a button can be dragged to another place among those that can.
        is_open: of a folder.
        of_spot: of a `card`: whether it is about what was touched on the map.
        value: of what holds one; the open one of `tabs`.
        options: of a `choice` or `list`.
        off: the options of a `choice` that can be seen but not used.
        words: the options that are no names that people gave; None: all.
        shown: what stands for the options in the page's language; none: they themselves.
        min: least value of a number.
        max: greatest value of a number.
        step: from one value of a number to the next.
        hint: says more than the label.
        content: of `html`, made safe.
        marks: of a `timeline`: times of a day [s] and their colours.
    """

    kind: Kind
    parent: int = 0
    order: float = 0.0
    label: str = ""
    is_name: bool = False
    icon: str = ""
    colour: Colour = "grey"
    is_hidden: bool = False
    is_disabled: bool = False
    can_move: bool = False
    is_open: bool = False
    of_spot: bool = False
    value: Value = None
    options: tuple[str, ...] = ()
    off: tuple[str, ...] = ()
    words: tuple[str, ...] | None = None
    shown: tuple[str, ...] = ()
    min: float | None = None
    max: float | None = None
    step: float | None = None
    hint: str = ""
    content: str = ""
    marks: tuple[tuple[float, Tone], ...] = ()


class Command(Struct, frozen=True, kw_only=True):
    """What a key does.

    Attributes:
        id: of the control that it stands for.
        title: what it is called in the list of commands.
        key: as `KeyboardEvent.key` names it, in small letters; of what moves a point the sign,
            such as "↑", with a "⇧" before it for Shift.
    """

    id: int
    title: str
    key: str


class ControlChanges(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What changed since the page was last told."""

    looks: dict[int, Look] = {}
    """By id; those that are new, too."""
    gone: list[int] = []
    commands: list[Command] | None = None
    """All of them, where any changed."""
