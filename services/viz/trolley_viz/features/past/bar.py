"""The strip below the map that leads into the past: a slider, what went wrong, and back to now."""

import datetime

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import leads, note
from trolley_viz.features.past.looking import FAST, Looking
from trolley_viz.features.past.record import Trouble
from trolley_viz.words.sentences import StatusLine

MAX_TROUBLES = 30
"""Number of troubles that are listed, the newest."""


class PastBar:
    """The strip on one page."""

    def __init__(self, gui: Controls, past: Looking) -> None:
        self._past = past
        self._base_ns = 0
        """The midnight before the first time on the slider [ns since boot]."""
        self._strip = gui.add_strip()
        with self._strip:
            self._timeline = gui.add_timeline("Time of day")
            self._play = gui.add_button("")
            self._fast = gui.add_button("")
            self._now = gui.add_button("Now", colour="green")
            self._close = gui.add_button("Close the past", icon="x")
            self._about = gui.add_html("")
            with gui.add_folder("What went wrong") as self._folder:
                self._troubles = gui.add_html("")
        self._timeline.on_change(lambda at_s: self._past.look(self._base_ns + int(at_s * 1e9)))
        self._play.on_press(self._past.play_or_pause)
        self._fast.on_press(self._past.change_speed)
        self._now.on_press(self._past.return_to_now)
        self._close.on_press(self._past.close)
        self._troubles.on_press(self._go_to)
        self.update()

    def update(self) -> None:
        """Show which time is looked at, and what there is to look at."""
        past = self._past
        self._strip.visible = past.is_open
        if not past.is_open:
            return
        troubles = past.troubles[-MAX_TROUBLES:]
        self._show_times(troubles)
        is_playing, is_fast = past.speed > 0.0, past.speed == FAST
        self._play.label = "Stop playing" if is_playing else "Play"
        self._play.icon = "player-pause" if is_playing else "player-play"
        self._fast.label = "Play at normal speed" if is_fast else "Play 8 times as fast"
        self._fast.icon = "player-track-next"
        self._fast.colour = "teal" if is_fast else "grey"
        self._now.disabled = not past.is_past
        self._about.content = note(self._words())
        self._folder.visible = bool(troubles)
        self._troubles.content = leads([(str(one.at_ns), self._line(one)) for one in troubles])

    # Inside.
    def _show_times(self, troubles: list[Trouble]) -> None:
        past, window = self._past, self._past.window
        first = past.wall_time(window.first_ns)
        midnight = datetime.datetime.combine(first.date(), datetime.time(), first.tzinfo)
        self._base_ns = window.first_ns - round((first - midnight).total_seconds() * 1e9)

        def of_day_s(at_ns: int) -> float:
            return (at_ns - self._base_ns) // 1_000_000_000

        seen = [one for one in troubles if window.first_ns <= one.at_ns <= window.last_ns]
        self._timeline.show(
            of_day_s(window.first_ns),
            of_day_s(window.last_ns),
            of_day_s(past.at_ns),
            [(of_day_s(one.at_ns), one.words.tone) for one in seen],
        )

    def _words(self) -> str:
        past = self._past
        first = past.wall_time(past.window.first_ns)
        if past.trip:
            return f"The trip “{past.trip}” of {first:%d %b %H:%M}.".replace("of 0", "of ")
        if past.is_short:
            return f"Recorded since {first:%H:%M:%S}, when the viewer began to watch this robot."
        return "The last 10 minutes. Past trips are in the “Tours” tab."

    def _line(self, trouble: Trouble) -> StatusLine:
        at = self._past.wall_time(trouble.at_ns)
        return StatusLine(f"{at:%H:%M:%S}", trouble.words.tone, f" {trouble.words.headline}")

    def _go_to(self, press: str) -> None:
        """Look at the time of a listed trouble."""
        if press in {str(one.at_ns) for one in self._past.troubles}:
            self._past.look(int(press))
