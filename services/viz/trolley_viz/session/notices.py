"""Notices at the edge of one browser's page: a title and a sentence, gone after a few seconds."""

import viser

from trolley_viz.sentences import Tone

NOTICE_S: dict[Tone, float] = {"good": 4.0, "busy": 4.0, "idle": 5.0, "warn": 8.0, "bad": 8.0}
MAX_NOTICES = 2
"""They cover part of the map."""
NOTICE_COLOURS: dict[Tone, tuple[int, int, int]] = {
    "good": (30, 158, 80),
    "busy": (47, 111, 224),
    "warn": (217, 138, 0),
    "bad": (214, 51, 51),
    "idle": (128, 136, 148),
}


class Notices:
    """The notices that one browser shows, never more than `MAX_NOTICES`."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._shown: list[viser.NotificationHandle] = []

    def show(self, title: str, text: str, tone: Tone) -> None:
        """Show a title and a sentence; the oldest notice goes where there is no room."""
        notice = self._client.add_notification(
            title, text, auto_close_seconds=NOTICE_S[tone], color=NOTICE_COLOURS[tone]
        )
        self._shown.append(notice)
        while len(self._shown) > MAX_NOTICES:
            self._shown.pop(0).remove()
