"""For engineers: where any frame is in any other, and a plot of any number that is published."""

import math
from collections.abc import Callable

from trolley import topics
from trolley.geometry import MissingLink
from trolley.geometry.frames import BASE, MAP
from trolley.geometry.relation import Relation, relation
from trolley.topics import Kind
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, plot, table, verbatim
from trolley_viz.controls.shared import AddFolder
from trolley_viz.overlays.cards import written
from trolley_viz.overlays.figures import plot_columns, plot_svg
from trolley_viz.overlays.readings import Reading, Readings
from trolley_viz.overlays.source import fields_of
from trolley_viz.robots.frames import PLACE, frames_of, why_nowhere
from trolley_viz.robots.view import View
from trolley_viz.scene.places import current_places
from trolley_viz.words.sentences import duration

MAX_CHOICES = 200
NO_TOPIC = "choose"
WINDOWS_S = {"10 s": 10.0, "1 min": 60.0, "10 min": 600.0}


class FramesPanel:
    """Distance, bearing, translation, rotation and age of two frames, or the missing link."""

    def __init__(self, gui: Controls, folder: AddFolder) -> None:
        with folder("Distance and angle"):
            self._parent = gui.add_list("From", (BASE, MAP), words=())
            self._child = gui.add_list("To", (BASE, MAP), value=MAP, words=())
            self._said = gui.add_html("")

    def update(self, view: View) -> None:
        """Say where the second frame is in the first."""
        frames = frames_of(view.streams, view.robot_ns, (self._parent.value, self._child.value))
        known = {BASE, MAP, *frames.tree.frames()}
        places = sorted({PLACE + one.name for one in current_places(view)} - known)
        options = [*sorted(known - set(places)), *places][:MAX_CHOICES]
        for frame in (self._parent, self._child):
            frame.options = sorted({*options, frame.value})
        try:
            found = relation(frames, self._parent.value, self._child.value)
        except MissingLink as missing:
            self._said.content = note(why_nowhere(frames, missing))
            return
        self._said.content = relation_table(found)


class PlotPanel:
    """The last minutes of any number that the robot publishes.

    Args:
        folder: adds its folder.
        new_readings: follows values of a robot.
        save_file: gives the person a file of this name and text.
    """

    def __init__(
        self,
        gui: Controls,
        folder: AddFolder,
        new_readings: Callable[[str], Readings],
        save_file: Callable[[str, str], None],
    ) -> None:
        self._new_readings = new_readings
        self._save_file = save_file
        self._readings: Readings | None = None
        self._robot = ""
        """The robot whose values they are."""
        self._text = ""
        with folder("Plot"):
            names = (NO_TOPIC, *(one.name for one in topics.TOPICS if one.kind is Kind.STREAM))
            self._topic = gui.add_list("Topic", names, words=(NO_TOPIC,))
            self._fields = gui.add_list("Field", (NO_TOPIC,), words=(NO_TOPIC,), disabled=True)
            self._source = gui.add_text(
                "Value", "", hint="For example odom:twist.vx or scan:ranges[0]"
            )
            self._window = gui.add_list("Time", tuple(WINDOWS_S), value="1 min")
            self._is_fixed = gui.add_check("Fixed range", False)
            self._low = gui.add_number("From", 0.0, visible=False)
            self._high = gui.add_number("Up to", 1.0, visible=False)
            self._picture = gui.add_html("")
            save = gui.add_button("Save as CSV", icon="download")
        self._topic.on_change(self._choose_topic)
        self._fields.on_change(self._choose_field)
        self._is_fixed.on_change(self._fix)
        save.on_press(self._save)

    def update(self, view: View) -> None:
        """Draw what is asked for."""
        self._text = self._source.value.strip()
        if not self._text:
            self.close()
            self._picture.content = ""
            return
        if self._robot != view.robot_name:
            self.close()
            self._robot = view.robot_name
        if self._readings is None:
            self._readings = self._new_readings(self._robot)
        readings = self._readings
        readings.follow([self._text])
        wanted = readings.frames_wanted()
        if wanted and readings.is_sampling_due(view.now_ns):
            readings.sample(frames_of(view.streams, view.robot_ns, wanted), view.now_ns)
        self._picture.content = self._drawn(readings.of(self._text), view)

    def close(self) -> None:
        """Stop following."""
        if self._readings is not None:
            self._readings.drop_all()
            self._readings = None

    def _drawn(self, reading: Reading, view: View) -> str:
        if reading.problem:
            return note(reading.problem)
        age_s = reading.age_s(view.now_ns)
        if age_s is None:
            return note("No data yet.")
        is_fixed, window_s = self._is_fixed.value, WINDOWS_S[self._window.value]
        svg = plot_svg(
            reading.history.lines(view.now_ns, window_s, plot_columns()),
            window_s,
            self._low.value if is_fixed else None,
            self._high.value if is_fixed else None,
        )
        is_silent = reading.is_silent(view.now_ns, view.silent, is_away=view.is_away)
        silence = note(f"No data for {age_s:.0f} s.") if is_silent else ""
        return (silence or verbatim(written(reading.value, ""))) + plot(svg)

    def _choose_topic(self, name: str) -> None:
        fields = [field for one in topics.TOPICS if one.name == name for field in fields_of(one)]
        self._fields.options = fields or (NO_TOPIC,)
        self._fields.disabled = not fields
        if fields:
            self._choose_field(self._fields.value)

    def _choose_field(self, field: str) -> None:
        self._source.value = f"{self._topic.value}:{field}"

    def _fix(self, is_fixed: bool) -> None:
        self._low.visible = self._high.visible = is_fixed

    def _save(self) -> None:
        if self._readings is None or not self._text:
            return
        name = "".join(one if one.isalnum() else "-" for one in self._text)
        self._save_file(f"{name}.csv", self._readings.of(self._text).history.csv())


def relation_table(found: Relation) -> str:
    """Where one frame is in another, as rows."""
    x, y, z = found.translation
    qx, qy, qz, qw = found.rotation
    rows: list[tuple[str, ...]] = [
        ("Distance", f"{found.distance:.3f} m"),
        ("Bearing", f"{math.degrees(found.bearing):.1f}° (left is positive)"),
        ("Translation", f"{x:.3f}, {y:.3f}, {z:.3f} m"),
        ("Rotation", f"{math.degrees(found.yaw):.1f}°"),
        ("Quaternion", f"{qx:.4f}, {qy:.4f}, {qz:.4f}, {qw:.4f}"),
        ("Age", "–" if found.age is None else duration(found.age)),
    ]
    return table(rows) + "".join(note(f"{one}.") for one in found.stale)
