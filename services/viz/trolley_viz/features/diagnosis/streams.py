"""The services with their health, and the streams that are followed with their rates."""

from trolley import topics
from trolley.messages import Health
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, row, table
from trolley_viz.robots.view import View
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import StatusLine, Tone, age_text

RATE_OVER_NS = 3_000_000_000
TONES: dict[str, Tone] = {"ok": "good", "starting": "busy", "degraded": "warn", "failed": "bad"}
SILENT_S = 3.0


class StreamPanel:
    """Two lists that are only read: services with their health, streams with their rates."""

    def __init__(self, gui: Controls) -> None:
        self._services = gui.add_html("")
        self._streams = gui.add_html("")
        self._counts: dict[str, int] = {}
        self._counted_ns = 0
        self._rates: dict[str, float] = {}

    def update(self, view: View) -> None:
        """Bring both up to date."""
        health, heard = (
            view.streams.by_parts(topics.HEALTH),
            view.streams.arrived_by_parts(topics.HEALTH),
        )
        lines = [
            service_line(name, one, (view.now_ns - heard.get((name,), 0)) * 1e-9)
            for (name,), one in sorted(health.items())
        ]
        self._services.content = "".join(map(row, lines)) or note("No services found.")
        self._count(view)
        rows = [
            (name, f"{self._rates[name]:.1f} Hz" if name in self._rates else "…")
            for name in self._counts
        ]
        self._streams.content = note("Streams from the robot, as they arrive") + table(
            rows, num_names=1
        )

    def _count(self, view: View) -> None:
        since_ns = view.now_ns - self._counted_ns
        if since_ns < RATE_OVER_NS and self._counts:
            return
        counts = view.streams.counts()
        self._rates = {
            name: max(count - self._counts[name], 0) / (since_ns * 1e-9)
            for name, count in counts.items()
            if name in self._counts
        }
        self._counts, self._counted_ns = counts, view.now_ns


def service_line(name: str, health: Health, age_s: float) -> StatusLine:
    """Say how a service is, what it takes, and when it was last heard."""
    takes = f"{100 * health.cpu:.0f} % of a core, {health.rss / 2**20:.0f} MB"
    heard = age_text(age_s, SILENT_S)
    if age_s > SILENT_S:
        return StatusLine(
            f"{name}: silent", "bad", f"last heard {heard} ago, when it said: {health.state}"
        )
    why = said(health.message)
    detail = f"{why.rstrip('.')}. {takes}" if why else takes
    return StatusLine(f"{name}: {health.state}", TONES[health.state], detail)
