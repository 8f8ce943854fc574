"""What a page and the viewer say to each other on the life line, as JSON.

Times are milliseconds by the viewer's own clock, which runs evenly and never jumps: a page adds to
the last one that it was told what has passed since by its own. So a telephone's clock may be a day
off, and what was under way for long shows as old.
"""

from typing import Annotated

from msgspec import Meta, Struct

from trolley_viz.controls.messages import ControlChanges, Value
from trolley_viz.joystick.joystick import Grip
from trolley_viz.joystick.teleop import PadState
from trolley_viz.languages.catalogue import ENGLISH
from trolley_viz.overlays.pages import Click, File, OverlayUpdate
from trolley_viz.robots.stop_presses import StopLine
from trolley_viz.words.sentences import StatusLine, Tone

PROTOCOL = 1

Time = Annotated[float, Meta(ge=0.0, le=1e15)]
Number = Annotated[int, Meta(ge=0, le=2**53)]
Name = Annotated[str, Meta(max_length=100)]
Pixels = Annotated[float, Meta(ge=1.0, le=100_000.0)]
Share = Annotated[float, Meta(ge=-100.0, le=100.0)]


class Press(Struct, frozen=True, kw_only=True):
    """A control was pressed, or given a value."""

    id: Number
    """Numbers the presses of a page; the answer names it."""
    at_ms: Time
    control: int
    value: Value = None


class Stop(Struct, frozen=True, kw_only=True):
    """A robot is to stop; however late this comes, it is done."""

    id: Number
    robots: Annotated[list[Name], Meta(max_length=100)]
    """Robots that must stop; none: all."""


class Resume(Struct, frozen=True, kw_only=True):
    """A robot may drive again."""

    id: Number
    at_ms: Time
    robot: Name


class Gesture(Struct, frozen=True, kw_only=True):
    """What a pointer did over the scene: one of these."""

    at_ms: Time
    released: tuple[Share, Share] | None = None
    """Where it was let go, as shares of the picture."""
    is_tap: bool = False
    """That it came down in the same place shortly before."""
    cancelled: bool = False
    """That the press was called off."""
    size: tuple[Pixels, Pixels] | None = None
    """Width and height of the picture."""


class Hold(Struct, frozen=True, kw_only=True):
    """The page is in sight, as a control of the kind `hold` wants to hear; it is not answered."""

    at_ms: Time
    control: int


class Said(Struct, frozen=True, kw_only=True):
    """What a page says: one of these."""

    beat_ms: Time | None = None
    """The newest time that it was told: it hears."""
    press: Press | None = None
    stop: Stop | None = None
    resume: Resume | None = None
    scene: Name | None = None
    """The secret by which viser's connection is known to be the same page's."""
    prefers_dark: bool | None = None
    """How the device is set."""
    language: Name | None = None
    """That of the device, as a tag such as "de-AT"."""
    time_zone: Name | None = None
    """That of the device, such as "Europe/Vienna"."""
    gesture: Gesture | None = None
    grip: Grip | None = None
    hold: Hold | None = None
    overlay: Click | None = None


class Hello(Struct, frozen=True, kw_only=True):
    """The first that a page is told."""

    protocol: int
    build: str
    """Build of the page's files: a page of another build reloads itself."""
    may_drive: bool


class Answer(Struct, frozen=True, kw_only=True):
    """What became of a press."""

    id: int
    is_done: bool
    text: str = ""
    """Why it was not done."""


class Notice(Struct, frozen=True, kw_only=True):
    """Something to be told for some seconds."""

    title: str
    text: str
    tone: Tone


class PageState(Struct, frozen=True, kw_only=True):
    """What a page shows beside its controls.

    Attributes:
        robot: the name of the robot that it follows.
        title: what people call it.
        sentence: what it is doing, or what keeps it from driving.
        lines: its state in detail.
        stop: what became of the last press of Stop.
        is_stopped: whether “Drive on” would let it drive again.
        stopped_by: that it was stopped and by whom, as far as it was at a page.
        hint: what an armed tool waits for.
        dark: whether it has the dark look.
        language: the code of the language in which it is told everything.
        has_scene: whether viser's connection of the page is known.
        has_letters: whether keys that are single letters do something.
        is_pointing: whether something is to be pointed out on the map.
        has_cursor: whether arrow keys point at something already.
        is_set_up: whether the robot is being set up: there is no map to see.
    """

    robot: str
    title: str
    sentence: StatusLine
    lines: list[StatusLine]
    stop: StopLine | None = None
    is_stopped: bool = False
    hint: str = ""
    dark: bool = False
    language: str = ENGLISH
    has_scene: bool = False
    stopped_by: str = ""
    has_letters: bool = True
    is_pointing: bool = False
    has_cursor: bool = False
    is_set_up: bool = False


class Told(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a page is told: any of these."""

    hello: Hello | None = None
    beat_ms: float | None = None
    answer: Answer | None = None
    notice: Notice | None = None
    file: File | None = None
    state: PageState | None = None
    controls: ControlChanges | None = None
    pad: PadState | None = None
    overlays: OverlayUpdate | None = None
