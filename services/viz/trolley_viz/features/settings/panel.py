"""The settings of the robot: those that people change, in plain words, and all others by name."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from trolley import topics
from trolley.config.changeable_settings import parse_value
from trolley.config.describe import to_toml
from trolley.messages import Setting
from trolley_viz.controls.controls import Check, Controls, Folder, Number
from trolley_viz.controls.markup import note, verbatim
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.settings.requests import Name, RobotSettings
from trolley_viz.robots.view import View
from trolley_viz.scene.places import current_places

QUIET_NS = 700_000_000
"""A number is sent once nobody has changed it for this long [ns]: who types 0.25 passes 0.2."""
DIGITS = 6
DEGREES = math.degrees(1.0)


class Words(NamedTuple):
    """How a setting is called on the page."""

    section: str
    key: str
    label: str
    step: float = 0.05
    most: float | None = None
    """A slider up to here; None: a number that is typed."""
    factor: float = 1.0
    """From the setting's unit to that of the page."""
    may_be_zero: bool = False


SPEED, WAITING, POSITION, START, ALL = (
    f"Settings: {name}" for name in ("speed", "waiting", "position", "start", "all by name")
)
GROUPS: Mapping[str, Sequence[Words]] = {
    SPEED: (
        Words("planner", "max_speed_mps", "Highest speed (m/s)", most=1.0),
        Words("planner", "unsure_speed_mps", "While unsure of its position (m/s)", most=0.5),
        Words("planner", "slow_speed_mps", "Right beside something (m/s)", most=0.5),
        Words("planner", "caution_distance_m", "Slow down when nearer than (m)", most=1.0),
        Words(
            "planner",
            "clearance_m",
            "Keep away where there is room (m)",
            0.01,
            0.3,
            may_be_zero=True,
        ),
        Words("planner", "acceleration_mps2", "Acceleration (m/s²)", most=2.0),
        Words("base.limits", "max_speed_mps", "Limit for all, by hand too (m/s)", most=1.0),
    ),
    WAITING: (
        Words("planner", "patience_s", "Wait where something is in the way (s)", 0.5),
        Words("planner", "give_up_s", "Try to get free for (s)", 1.0),
        Words("tour", "stop_timeout_s", "Longest drive to one stop of a tour (s)", 1.0),
        Words("tour", "retry_wait_s", "Wait before a stop is tried again (s)", 0.5),
        Words("tour", "low_battery", "Drive home below this charge (%)", 1.0, 90.0, 100.0, True),
        Words("planner", "control_rate_hz", "Commands per second", 1.0, 30.0),
    ),
    POSITION: (
        Words("localizer", "update_distance_m", "Compare with the map every (m)", 0.01, 0.5),
        Words("localizer", "update_turn_rad", "Compare with the map every (°)", 0.5, 45.0, DEGREES),
        Words("localizer", "num_beams", "Beams to compare with", 10.0),
        Words("localizer", "max_spread_m", "Unsure if it may be off by (m)", 0.05, 2.0),
        Words("localizer", "lost_after_s", "Lost when nothing fits for (s)", 0.5),
        Words("localizer", "search_again_s", "Search again after (s)", 0.5),
    ),
}
AT_ONCE = "What you change here counts at once."
AT_START = "It counts the next time the robot is started."
UNKNOWN = "The settings are being fetched …"
ONLY_IN_FILE = "It can only be changed in robot.toml, on the robot."
KEPT = "It was set while the robot ran, and overrides robot.toml."
SEARCH, PLACE, COORDINATES = "searches the map", "is at a place", "is at these coordinates"


class SettingsPanel:
    """Four folders for people and one for engineers, filled when they are opened."""

    def __init__(self, gui: Controls, add_folder: AddFolder, settings: RobotSettings) -> None:
        self._settings = settings
        self._groups = [
            GroupPanel(gui, add_folder(title), words, self._settings)
            for title, words in GROUPS.items()
        ]
        self._start = StartPanel(gui, add_folder(START), self._settings)
        self._named = NamedPanel(gui, add_folder(ALL), self._settings)

    def update(self, view: View) -> None:
        """Show what is, where it is looked at, and send what was changed."""
        panels = (*self._groups, self._start, self._named)
        for panel in panels:
            panel.state.visible = not self._settings.known
            panel.state.content = note(self._settings.trouble or UNKNOWN)
        if not any(panel.folder.is_open for panel in panels):
            return
        self._settings.update(view.streams.latest(topics.CONFIG))
        for group in self._groups:
            group.update(view.now_ns)
        self._start.update(view)
        self._named.update()


class GroupPanel:
    """Some settings that count at once.

    Args:
        gui: of the page.
        folder: that they stand in.
        words: what they are called.
        settings: what they are.
    """

    def __init__(
        self, gui: Controls, folder: Folder, words: Sequence[Words], settings: RobotSettings
    ) -> None:
        self._settings = settings
        self.folder = folder
        self._fields: dict[Name, tuple[Words, Number]] = {}
        self._num_told = 0
        self._changed: dict[Name, float] = {}
        """What was changed on the page and is not sent yet."""
        self._changed_ns = 0
        self._is_new = False
        with folder:
            self.state = gui.add_html("")
            self._hint = gui.add_html(note(AT_ONCE))
            for one in words:
                self._add(gui, one)

    def update(self, now_ns: int) -> None:
        """Show what the robot told, and send what nobody changes any more."""
        known = self._settings.known
        self._hint.visible = bool(known)
        for name, (_, field) in self._fields.items():
            field.visible = name in known
        if not known:  # another robot: what was changed is none of its
            self._changed.clear()
        if self._is_new:
            self._is_new, self._changed_ns = False, now_ns
        if self._changed and now_ns - self._changed_ns >= QUIET_NS:
            self._send()
        if self._num_told != self._settings.num_told:
            self._num_told = self._settings.num_told
            for name, (words, field) in self._fields.items():
                if name in known and name not in self._changed:
                    _show(known[name], words, field)

    def _add(self, gui: Controls, words: Words) -> None:
        name, label = (words.section, words.key), words.label
        if words.most is None:
            field = gui.add_number(label, 0.0, step=words.step, visible=False)
        else:
            field = gui.add_slider(
                label, 0.0, min=0.0, max=words.most, step=words.step, visible=False
            )
        field.on_change(lambda value: self._note(name, value))
        self._fields[name] = words, field

    def _note(self, name: Name, value: float) -> None:
        self._changed[name] = value
        self._is_new = True

    def _send(self) -> None:
        """Send what was changed, the settings of each section together."""
        values: dict[str, dict[str, Any]] = {}
        for name, value in self._changed.items():
            words, _ = self._fields[name]
            wanted: float | int = round(value / words.factor, DIGITS)
            if isinstance(self._settings.known[name].default, int):
                wanted = round(wanted)
            values.setdefault(words.section, {})[words.key] = wanted
        self._changed.clear()
        for section, wanted_of in values.items():
            self._settings.change(section, wanted_of)


def _show(setting: Setting, words: Words, field: Number) -> None:
    """Show what a setting is, and between which numbers it may be."""
    value = round(float(setting.value) * words.factor, DIGITS)
    least = 0.0 if words.may_be_zero else words.step
    if setting.least is not None:
        least = max(least, round(setting.least * words.factor, DIGITS))
    most = None if words.most is None else max(words.most, value)
    if most is None and setting.greatest is not None:
        most = round(setting.greatest * words.factor, DIGITS)
    field.set_range(min(least, value), most)
    field.value = value


class StartPanel:
    """Where the robot is when it is switched on: where it was, or else as is said here."""

    def __init__(self, gui: Controls, folder: Folder, settings: RobotSettings) -> None:
        self._settings = settings
        self.folder = folder
        self._num_told = 0
        self._view: View | None = None
        with folder:
            self.state = gui.add_html("")
            self._inside = gui.add_folder(visible=False)
            with self._inside:
                gui.add_html(note("Switched on, the robot knows where it was before."))
                self._kind = gui.add_list(
                    "If it does not know that, it", (SEARCH, PLACE, COORDINATES)
                )
                self._place = gui.add_list("Place", (), words=(), visible=False)
                self._at = gui.add_folder(visible=False)
                with self._at:
                    self._x = gui.add_number("x (m)", 0.0, step=0.01)
                    self._y = gui.add_number("y (m)", 0.0, step=0.01)
                    self._heading = gui.add_number("Heading (°)", 0.0, step=1.0)
                    here = gui.add_button("Where it is now", icon="robot")
                self._always: Check = gui.add_check("Even if it knows where it was", False)
                gui.add_html(note(AT_START))
                save = gui.add_button("Save the start", icon="device-floppy", colour="green")
        here.on_press(self._take_pose)
        save.on_press(self._save)

    def update(self, view: View) -> None:
        """Show what robot.toml says, until something is changed here."""
        self._view = view
        self._inside.visible = ("start", "pose") in self._settings.known
        names = sorted((one.name for one in current_places(view)), key=str.casefold)
        chosen = self._place.value
        self._place.options = names if chosen in ("", *names) else [chosen, *names]
        if self._inside.visible and self._num_told != self._settings.num_told:
            self._num_told = self._settings.num_told
            self._fill(names)
        self._place.visible = self._kind.value == PLACE
        self._at.visible = self._kind.value == COORDINATES
        self._always.visible = self._kind.value != SEARCH

    def _fill(self, names: Sequence[str]) -> None:
        pose = self._settings.known["start", "pose"].next
        self._always.value = bool(self._settings.known["start", "always"].next)
        if pose is None:
            self._kind.value = SEARCH
        elif isinstance(pose, str):
            self._kind.value = PLACE
            self._place.options = names if pose in names else [pose, *names]
            self._place.value = pose
        else:
            self._kind.value = COORDINATES
            self._show(pose["x"], pose["y"], _yaw_of(pose))

    def _show(self, x: float, y: float, yaw: float) -> None:
        self._x.value, self._y.value = round(x, 3), round(y, 3)
        self._heading.value = round(math.degrees(yaw), 1)

    def _take_pose(self) -> None:
        """Fill in where the robot is."""
        estimate = None if self._view is None else self._view.streams.latest(topics.POSE)
        if estimate is not None and estimate.pose is not None:
            self._show(estimate.pose.x, estimate.pose.y, estimate.pose.yaw)

    def _save(self) -> None:
        pose: Any = None
        if self._kind.value == PLACE:
            pose = self._place.value or None
        elif self._kind.value == COORDINATES:
            yaw = round(math.radians(self._heading.value), 4)
            pose = {"x": self._x.value, "y": self._y.value, "yaw": yaw}
        always = self._always.value and pose is not None
        self._settings.change("start", {"pose": pose, "always": always})


class NamedPanel:
    """Every setting by its name, with what docs/configuration.md says about it."""

    def __init__(self, gui: Controls, folder: Folder, settings: RobotSettings) -> None:
        self._settings = settings
        self.folder = folder
        self._shown: Setting | None = None
        with folder:
            self.state = gui.add_html("")
            self._name = gui.add_list("Setting", (), words=(), visible=False)
            self._meaning = gui.add_html("")
            self._counts = gui.add_html("")
            self._value = gui.add_text("Value, as in robot.toml", "", visible=False)
            self._set = gui.add_button("Change", icon="check", colour="green", visible=False)
        self._set.on_press(self._change)

    def update(self) -> None:
        """Show the one that is chosen."""
        known = {f"{section}.{key}": one for (section, key), one in self._settings.known.items()}
        self._name.options = list(known)
        one = known.get(self._name.value)
        self._name.visible = self._value.visible = self._set.visible = one is not None
        if one is None or one == self._shown:
            return
        self._shown = one
        default = "" if one.default is None else f" Default: {to_toml(one.default)}."
        meaning = f"{one.meaning} Allowed: {one.allowed}.{default}"
        self._meaning.content = verbatim(meaning, language="en")
        self._counts.content = note(_counts(one))
        self._value.value = "" if one.next is None else to_toml(one.next)
        self._value.disabled = self._set.disabled = one.acts == "file"

    def _change(self) -> None:
        one, text = self._shown, self._value.value.strip()
        if one is not None:
            self._settings.change(one.section, {one.key: parse_value(text) if text else None})


def _counts(one: Setting) -> str:
    """Say when a change counts, and whether what is comes from elsewhere than robot.toml."""
    if one.acts == "file":
        return ONLY_IN_FILE
    when = "It counts at once." if one.acts == "at_once" else AT_START
    return f"{KEPT} {when}" if one.source == "settings_toml" else when


def _yaw_of(pose: Mapping[str, Any]) -> float:
    """Return the heading [rad] of a pose as it stands in a file."""
    if pose.get("orientation") is not None:
        _, _, z, w = pose["orientation"]
        return 2.0 * math.atan2(z, w)
    return float(pose.get("yaw") or 0.0)
