"""An open page: its line, its session and its controls."""

import re
from dataclasses import dataclass
from typing import Any

from trolley import requests
from trolley.codes import Refused
from trolley.messages import BaseState
from trolley.messages.request_params import Nothing
from trolley_viz.controls.controls import BadValue, Controls, NotThere
from trolley_viz.joystick.joystick import Grip
from trolley_viz.joystick.teleop import PadState, Teleop
from trolley_viz.languages.translator import translator_of
from trolley_viz.overlays.cards import CardContext
from trolley_viz.overlays.pages import OverlayPages, ShownOverlays
from trolley_viz.pages.known import now_line, robot_state, state_lines, under_way
from trolley_viz.pages.language import in_language
from trolley_viz.robots.situation import situation
from trolley_viz.robots.stop_presses import DISOBEYED, UNCONFIRMED
from trolley_viz.robots.view import View
from trolley_viz.scene.overlays import OverlayLayer
from trolley_viz.server.devices import by
from trolley_viz.server.lines import Line
from trolley_viz.server.messages import (
    PROTOCOL,
    Answer,
    Gesture,
    Hello,
    Hold,
    PageState,
    Press,
    Resume,
    Said,
    Stop,
    Told,
)
from trolley_viz.server.visitors import Visitor
from trolley_viz.server.web_server import BUILD
from trolley_viz.session.browser_choices import Choices
from trolley_viz.session.hub import Hub
from trolley_viz.session.session import PagePort, Session
from trolley_viz.tabs.console import Console
from trolley_viz.words.sentences import refusal

SILENCE_S = 1.4
"""A page that was not heard for this long is gone. It speaks at least every half second, and is
looked after at each tick (0.05 s): so it is known within 1.5 s."""
KEPT_NS = 30_000_000_000
"""A page that comes back within this time is the same: what was begun there goes on."""
LATE_MS = 2000.0
"""What was pressed longer ago is not done any more: whoever pressed it may have gone."""
GOES_ON_NS = 2_000_000_000
"""What was stopped continues this long after “Drive on” was answered, if the robot may drive."""
AHEAD_MS = 500.0
"""No press comes from farther in the future; the clock of a page that says so is wrong."""
LATE_HOLD_MS = 700.0
"""A page that was in sight so long ago need not be any more."""
MAX_AWAITED = 50
"""With so many robots that have yet to answer a Stop, none is awaited of which nobody has heard."""
ROBOT_NAME = re.compile(r"[a-z0-9_-]{1,32}")
"""Pattern of `RobotName`: no other name may get into a key."""


@dataclass(frozen=True)
class Shared:
    """What all pages share besides the hub: joysticks and overlays."""

    joystick: Teleop
    overlays: OverlayPages


class Page:
    """An open page of one browser, from its first connection to 30 s after its last.

    Args:
        number: tells it from all others.
        key: its secret, by which it is known when it comes back.
        visitor: who it is.
        choices: what was chosen in this browser before.
        hub: what all pages share.
        shared: the joysticks and overlays of all pages.
    """

    def __init__(
        self, number: int, key: str, visitor: Visitor, choices: Choices, hub: Hub, shared: Shared
    ) -> None:
        self.key = key
        self.visitor = visitor
        self.controls = Controls()
        """What its person can press."""
        self.session = Session(hub, PagePort(number, visitor, self.controls, self.say), choices)
        """What it shows and may do."""
        self._console = Console(self.controls, self.session)
        self._number = number
        self._hub = hub
        self._shared = shared
        self._line: Line | None = None
        self._state: PageState | None = None
        self._pad: PadState | None = None
        self._heard_ns = 0
        self._goes_on = "", 0
        """The robot that continues what was stopped as soon as it may drive, and until when."""
        self._since_ns = hub.service.monotonic_ns
        self._language = self.session.preferences.language

    # What it is.
    @property
    def robot(self) -> str:
        """The name of the robot that it follows."""
        return self.session.robot

    @property
    def may_drive(self) -> bool:
        """Whether its person may do more than look and press Stop."""
        return self.visitor.role == "operator"

    def shown_layers(self) -> set[str]:
        """The keys of the layers that it shows."""
        if self.session.window.picture.client is None:
            return set()
        return {key for key, is_on in self.session.preferences.layers.items() if is_on}

    @property
    def is_connected(self) -> bool:
        """Whether it has a line now."""
        return self._line is not None

    def is_over(self, now_ns: int) -> bool:
        """Whether it has been gone for too long to come back."""
        return self._line is None and now_ns - self._heard_ns > KEPT_NS

    # Its line.
    def connect(self, line: Line, now_ns: int) -> None:
        """Take a line, in place of the one that there was, and tell it everything."""
        old = self._line
        if old is not None:
            self.disconnect(old)
            old.close()
        self._line, self._heard_ns = line, now_ns
        self._hub.people.come(self._number, self.visitor, lambda: self.robot, self._since_ns)
        self._forget_told()
        hello = Hello(protocol=PROTOCOL, build=BUILD, may_drive=self.may_drive)
        line.send(Told(hello=hello, beat_ms=now_ns * 1e-6))

    def is_on(self, line: Line) -> bool:
        """Whether this is its line now."""
        return self._line is line

    def disconnect(self, line: Line) -> None:
        """Note that a line is gone; whoever drove by hand has let go."""
        if self.is_on(line):
            self._line = None
            self._shared.joystick.leave(self._number)
            self._hub.people.go(self._number)

    def give_up_if_silent(self, now_ns: int) -> None:
        """Give up a page that says nothing; what came and waits to be handled counts as heard."""
        line = self._line
        if line is None or (now_ns - self._heard_ns) * 1e-9 <= SILENCE_S:
            return
        if line.silence_s > SILENCE_S:
            self.disconnect(line)
            line.close()

    def beat(self, now_ns: int) -> None:
        """Let the page know that the viewer lives."""
        if self._line is not None:
            self._line.send(Told(beat_ms=now_ns * 1e-6))

    def say(self, told: Told) -> None:
        """Tell the page something in its language, if it hears."""
        if self._line is not None:
            self._line.send(in_language(told, translator_of(self._language)))

    def hear(self, said: Said, now_ns: int) -> None:
        """Do what the page says."""
        self._heard_ns = now_ns
        now_ms = now_ns * 1e-6
        if said.stop is not None:
            self._stop(said.stop)
        if said.press is not None and self._is_timely(said.press, now_ms):
            self._press(said.press)
        if said.resume is not None and self._is_timely(said.resume, now_ms):
            self._resume(said.resume)
        self._hear_of_device(said)
        if said.gesture is not None:
            is_late = not -AHEAD_MS <= now_ms - said.gesture.at_ms <= LATE_MS
            self._gesture(said.gesture, is_late=is_late)
        if said.grip is not None and self.may_drive:
            self._grip(said.grip)
        if said.hold is not None:
            self._hold(said.hold, now_ms)
        if said.overlay is not None:
            shown = self._shown_overlays()
            if shown is not None:
                file = self._shared.overlays.clicked(shown, said.overlay, may_choose=self.may_drive)
                if file is not None:
                    self.say(Told(file=file))

    def close(self) -> None:
        """Forget it: nobody comes back."""
        self.session.put_tools_away()
        self.session.detach()
        self._console.close()
        self._shared.joystick.leave(self._number)
        self._shared.overlays.forget(self._number)

    def update(self, view: View) -> None:
        """Tell the page what changed, if it has taken what it was told before."""
        known = robot_state(view)
        people, own = self._hub.people, self._hub.people.name_of(self._number)
        sender = people.senders.of(view.robot_name, under_way(known))
        stopper = people.stoppers.of(view.robot_name, known.base)
        lines = state_lines(known, sender and by(sender, own))
        now = situation(known)
        then = self.session.past.sentence("" if view.map is None else view.map.name)
        self._console.update(view, lines)
        base = known.base
        self._go_on(base, view)
        line = self._line
        if line is None or not line.is_clear:
            return
        if self._language != self.session.preferences.language:
            self._language = self.session.preferences.language
            self._forget_told()
        shown = self._shown_overlays()
        stop = self._hub.stops.line(view.robot_name, view.now_ns)
        if stop is None and base is not None and base.not_stopped:
            stop = DISOBEYED
        elif stop is None and base is not None and base.is_stop_unconfirmed:
            stop = UNCONFIRMED
        state = PageState(
            robot=view.robot_name,
            title=view.robot_name if view.robot is None else view.robot.title or view.robot_name,
            sentence=then or now,
            lines=[now_line(now), *lines] if then else lines,
            stop=stop,
            is_stopped=view.is_halted,
            hint=self.session.hint,
            dark=self.session.preferences.is_dark,
            language=self._language,
            has_scene=self.session.window.picture.client is not None,
            has_letters=self.session.preferences.has_letters,
            is_pointing=self.session.pointing.tool is not None,
            has_cursor=self.session.pointing.cursor is not None,
            is_set_up=view.setup is not None,
            stopped_by=f"Stopped {by(stopper, own)}" if stopper else "",
        )
        pad = self._shared.joystick.state(self._number, view) if self.may_drive else None
        told = Told(
            state=None if state == self._state else state,
            controls=self.controls.take_changes(),
            pad=None if pad == self._pad else pad,
            overlays=self._shared.overlays.changes(self._number, shown, may_choose=self.may_drive),
        )
        self._state, self._pad = state, pad
        if told != Told():
            self.say(told)

    # Inside.
    def _forget_told(self) -> None:
        """Tell it everything again."""
        self._state = self._pad = None
        self.controls.forget_sent()
        self._shared.overlays.forget(self._number)

    def _hear_of_device(self, said: Said) -> None:
        """Note how the device is set."""
        if said.prefers_dark is not None:
            self.session.prefer_dark(is_dark=said.prefers_dark)
        if said.language is not None:
            self.session.preferences.note_device_language(said.language)
        if said.time_zone is not None:
            self.session.preferences.note_time_zone(said.time_zone)

    def _is_timely(self, pressed: Press | Resume, now_ms: float) -> bool:
        """Whether a press is new; says so to the page if it is not."""
        late_ms = now_ms - pressed.at_ms
        if -AHEAD_MS <= late_ms <= LATE_MS:
            return True
        why = (
            f"It was pressed {late_ms * 1e-3:.0f} s ago. Press again if you still want it."
            if late_ms > 0.0
            else "The page's clock is wrong. Reload it."
        )
        self.say(Told(answer=Answer(id=pressed.id, is_done=False, text=why)))
        return False

    def _press(self, press: Press) -> None:
        self.session.drags.do_missed_tap()
        try:
            self.controls.handle(press.control, press.value)
        except NotThere:
            answer = Answer(id=press.id, is_done=False, text="This can no longer be pressed.")
        except BadValue as bad:
            answer = Answer(id=press.id, is_done=False, text=f"Not understood: {bad}.")
        else:
            answer = Answer(id=press.id, is_done=True)
        self.say(Told(answer=answer))

    def _hold(self, hold: Hold, now_ms: float) -> None:
        if -AHEAD_MS <= now_ms - hold.at_ms <= LATE_HOLD_MS:
            self.controls.hold(hold.control)

    def _stop(self, stop: Stop) -> None:
        hub = self._hub
        self.session.past.return_to_now()
        self.session.drags.forget_missed_tap()
        # A viewer that has just started has not heard of all robots yet.
        named = [name for name in stop.robots if ROBOT_NAME.fullmatch(name)]
        known = hub.robots.names(self.robot)
        for robot in sorted(named or known, key=lambda name: name not in known):
            if robot not in known and hub.stops.num_waiting >= MAX_AWAITED:
                return  # unanswered: the page says that it has not stopped
            hub.press_stop(robot, self.visitor)
        self.say(Told(answer=Answer(id=stop.id, is_done=True)))

    def _resume(self, resume: Resume) -> None:
        if not self.may_drive or resume.robot not in self._hub.robots.names(self.robot):
            why = (
                "You may look, but not drive." if not self.may_drive else "There is no such robot."
            )
            self.say(Told(answer=Answer(id=resume.id, is_done=False, text=why)))
            return

        self.session.past.return_to_now()
        actions = self.session.actions
        goes_on = resume.robot == self.robot and actions.was_stopped

        def answered(reply: Any) -> None:
            self._hub.stops.resumed(resume.robot)
            if goes_on and not isinstance(reply, Refused):
                self._goes_on = resume.robot, self._hub.service.monotonic_ns + GOES_ON_NS
            why = refusal(reply) if isinstance(reply, Refused) else ""
            self.say(Told(answer=Answer(id=resume.id, is_done=not why, text=why)))

        self._hub.stops.release(resume.robot)
        self._hub.people.stoppers.release(resume.robot)
        self._hub.service.request(requests.BASE_RESUME, Nothing(), answered, robot=resume.robot)

    def _go_on(self, base: BaseState | None, view: View) -> None:
        """Continue what was stopped, unless the robot may drive so late that nobody expects it."""
        robot, until_ns = self._goes_on
        is_meant = view.robot_name == robot and view.now_ns < until_ns
        if base is not None and base.mode == "ok" and is_meant:
            self._goes_on = "", 0
            self.session.actions.steer("Continue")

    def _grip(self, grip: Grip) -> None:
        if grip.held:
            self.session.past.return_to_now()
        self._shared.joystick.hear(self._number, self.robot, grip)

    def _gesture(self, gesture: Gesture, *, is_late: bool) -> None:
        session = self.session
        if gesture.size is not None:
            session.window.resized(gesture.size)
        elif gesture.cancelled or (is_late and gesture.released is not None):
            session.drags.cancelled(is_late=not gesture.cancelled)
        elif gesture.released is not None:
            session.released(gesture.released, is_tap=gesture.is_tap)

    def _shown_overlays(self) -> ShownOverlays | None:
        session = self.session
        if not session.preferences.layers[OverlayLayer.key]:
            return None
        scene = self._hub.scenes.by_robot.get(session.robot)
        if scene is None:
            return None
        view = scene.view
        context = CardContext(self._hub.service.monotonic_ns, view.is_away, view.silent)
        return ShownOverlays(session.robot, scene.overlays, context)
