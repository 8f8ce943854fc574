"""Stop and Resume, always in sight: over the scene, whatever tab is open or scrolled.

viser lays its controls out in a panel that can be scrolled and folded away. A style sheet, which
finds the buttons by viser's own ids, takes these two out of it; it also hides the handles that fold
the panel, since what is folded away is gone. Notices lie over the map for some seconds; the map
under them can be pressed.
"""

import html
from collections.abc import Callable
from typing import Any, cast

import viser

from trolley_viz.panels.controls import GREEN, GREY, STOP_RED
from trolley_viz.robots.stop_presses import StopLine

STYLE = """<style>
[id="{stop}"],[id="{resume}"]{{position:fixed;z-index:9000;bottom:18px;height:66px!important;
 border-radius:12px;box-shadow:0 3px 12px rgba(0,0,0,.35)}}
[id="{stop}"]{{left:18px;width:200px;font-size:27px;font-weight:700;letter-spacing:.02em}}
[id="{resume}"]{{left:230px;width:120px;padding:0 8px;font-size:17px}}
[id="{stop}"] .mantine-Button-section>div,[id="{resume}"] .mantine-Button-section>div{{
 width:1.2em;height:1.2em;margin-right:.4em}}
[id="{stop}"] svg,[id="{resume}"] svg{{width:100%;height:100%}}
#trolley-stop{{position:fixed;z-index:9000;left:18px;bottom:96px;max-width:min(80vw,560px)}}
#trolley-stop div{{padding:10px 16px;border-radius:10px;color:#fff;font-size:19px;font-weight:700;
 line-height:1.3;box-shadow:0 3px 12px rgba(0,0,0,.35)}}
#trolley-hint{{position:fixed;z-index:8000;left:570px;bottom:30px;max-width:32vw;padding:9px 16px;
 border-radius:10px;background:#0b6b35;color:#fff;font-size:15px}}
@keyframes trolley-flash{{50%{{opacity:.55}}}}
.trolley-flash{{animation:trolley-flash .8s infinite}}
.mantine-Notification-root{{pointer-events:none}}
.mantine-Notification-root button{{pointer-events:auto}}
[data-dock-region-collapse]{{display:none!important}}
[data-dock-region-handle]{{pointer-events:none}}
@media (max-width:80em){{
 #trolley-hint{{left:18px;bottom:160px;max-width:calc(100vw - 400px)}}
}}
@media (max-width:60em){{
 [id="{stop}"]{{left:10px;width:128px;padding:0 6px;font-size:21px}}
 [id="{resume}"]{{left:146px;width:96px;padding:0 4px;font-size:15px}}
 #trolley-stop{{left:10px;max-width:45vw}}
 #trolley-hint{{left:10px}}
}}
@media (max-width:36em){{
 [id="{stop}"],[id="{resume}"]{{top:10px;bottom:auto;height:56px!important}}
 [id="{stop}"]{{width:160px;font-size:27px}}
 [id="{resume}"]{{left:180px;width:124px;font-size:17px}}
 #trolley-stop{{top:76px;bottom:auto;max-width:80vw}}
 .mantine-Notifications-root{{margin-top:60px;left:10px!important;max-width:none!important;
  width:calc(100vw - 20px)!important}}
 .mantine-Notification-root{{padding:5px 4px 5px 18px}}
 .mantine-Notification-body{{font-size:14px;line-height:1.25}}
 .mantine-Notification-title,.mantine-Notification-description{{display:inline;font-size:inherit;
  line-height:inherit;white-space:normal}}
 .mantine-Notification-title::after{{content:". "}}
 .mantine-Paper-root[style*="width: 20em"]{{width:100%!important;border-radius:14px 14px 0 0}}
 .mantine-ScrollArea-content>div[style*="width: 20em"]{{width:100%!important}}
 div[style*="cursor: pointer"][style*="height: 3.5em"]{{pointer-events:none;height:2.6em!important}}
 div[style*="cursor: pointer"][style*="height: 3.5em"] svg{{pointer-events:auto}}
 [data-autosize],[data-autosize] [data-scrollarea-viewport]{{max-height:46vh!important}}
 #trolley-hint{{z-index:8950;left:10px;right:10px;top:128px;bottom:auto;max-width:none}}
}}
</style>"""

RED, DARK_RED = "#d21f1f", "#8c0d0d"


class StopBar:
    """The two buttons and the line above them; the tool's hint over the scene, too.

    Args:
        gui: where they are added.
        stop: called when Stop is pressed.
        resume: called when Resume is pressed; None where that is not the person's to do.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        stop: Callable[[], None],
        resume: Callable[[], None] | None,
    ) -> None:
        self._stop = gui.add_button("STOP", color=STOP_RED, icon=viser.Icon.HAND_STOP)
        self._resume = gui.add_button(
            "Resume", color=GREY, icon=viser.Icon.PLAYER_PLAY, visible=resume is not None
        )
        gui.add_html(STYLE.format(stop=_element_id(self._stop), resume=_element_id(self._resume)))
        self._line = gui.add_html("")
        self._hint = gui.add_html("")

        # async: viser runs such callbacks in order and at once, not on a pool of threads.
        async def pressed(_: viser.GuiEvent[Any]) -> None:
            stop()

        async def resumed(_: viser.GuiEvent[Any]) -> None:
            if resume is not None:
                resume()

        self._stop.on_click(pressed)
        self._resume.on_click(resumed)
        gui.add_command(
            "Stop the robot", hotkey="S", modifier="shift", icon=viser.Icon.HAND_STOP
        ).on_trigger(self._trigger(stop))
        gui.add_command("Stop", hotkey="space", icon=viser.Icon.HAND_STOP).on_trigger(
            self._trigger(stop)
        )

    def show(self, line: StopLine | None, *, is_stopped: bool) -> None:
        """Show the outcome of the last press. A stopped robot lights up Resume."""
        text, is_alarm = (line.text, line.is_alarm) if line is not None else ("", False)
        if line is None and is_stopped:
            text = "Stopped"
        colour, flash = (DARK_RED, "trolley-flash") if is_alarm else (RED, "")
        content = f'<div class="{flash}" style="background:{colour}">{html.escape(text)}</div>'
        self._line.content = f'<div id="trolley-stop">{content}</div>' if text else ""
        self._resume.color = GREEN if is_stopped else GREY

    def show_hint(self, text: str) -> None:
        """Say what the armed tool waits for; "" says nothing."""
        self._hint.content = f'<div id="trolley-hint">{html.escape(text)}</div>' if text else ""

    @staticmethod
    def _trigger(stop: Callable[[], None]) -> Callable[[Any], Any]:
        async def trigger(_: Any) -> None:
            stop()

        return trigger


def _element_id(button: viser.GuiButtonHandle) -> str:
    """The id of a button in the page: viser's own, as nothing else tells two buttons apart."""
    state = cast(Any, button)._impl
    return str(state.uuid)
