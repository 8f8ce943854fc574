"""Small buttons over the map: from where it is seen."""

from dataclasses import replace

from trolley_viz.controls.controls import Controls
from trolley_viz.session.session import Session


class ViewBar:
    """Turns the camera of one browser."""

    def __init__(self, gui: Controls, session: Session) -> None:
        self._session = session
        with gui.add_bar():
            fit = gui.add_button("Show the whole map", icon="maximize")
            self._above = gui.add_button("")
            self._follow = gui.add_button("")
            self._turn = gui.add_button("")
            self._past = gui.add_button("Past", icon="history")
        fit.on_press(session.window.fit)
        self._above.on_press(self._change_height)
        self._follow.on_press(self._follow_or_stay)
        self._turn.on_press(self._turn_or_not)
        self._past.on_press(self._open_or_close_past)
        self.update()

    def update(self) -> None:
        """Say what each would do now."""
        look = self._session.window.look
        self._above.label = "Look from the side" if look.is_flat else "Look from above"
        self._above.icon = "perspective" if look.is_flat else "square"
        self._follow.label = "Stop following the robot" if look.follows else "Follow the robot"
        self._follow.icon = "focus-2"
        self._follow.colour = "teal" if look.follows else "grey"
        self._turn.label = "Keep north up" if look.turns else "Turn with the robot"
        self._turn.icon = "navigation-north" if look.turns else "navigation"
        self._turn.colour = "teal" if look.turns else "grey"
        self._past.colour = "teal" if self._session.past.is_open else "grey"

    def _change_height(self) -> None:
        look = self._session.window.look
        self._session.window.change_look(replace(look, is_flat=not look.is_flat))

    def _follow_or_stay(self) -> None:
        look = self._session.window.look
        self._session.window.change_look(replace(look, follows=not look.follows, turns=False))

    def _turn_or_not(self) -> None:
        look = self._session.window.look
        self._session.window.change_look(replace(look, follows=True, turns=not look.turns))

    def _open_or_close_past(self) -> None:
        past = self._session.past
        if past.is_open:
            past.close()
        else:
            past.open()
