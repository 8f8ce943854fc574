"""A page as its person uses it: what is shown there, and pressed by what stands on it."""

import html
import re
from collections.abc import Callable, Iterator
from typing import Any

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.messages import Look

CONTAINERS = ("actions", "bar", "card", "folder", "strip", "tab", "tabs", "tiles")


class PageOf:
    """All of a page, or what is in one of its folders; folders are always open here.

    Args:
        controls: of the page.
        part: the folder or tab that is looked into, 0 for all.
        wait: lets some time pass: a tab that is opened is brought up to date then.
    """

    def __init__(
        self, controls: Controls, part: int = 0, wait: Callable[[], None] = lambda: None
    ) -> None:
        self._controls = controls
        self._part = part
        self._wait = wait

    # Where to look.
    def within(self, title: str) -> "PageOf":
        """Return a folder or tab, by its title or by a text that stands in it and nowhere else."""
        shown = list(self._shown())
        titled = [id_ for id_, look in shown if look.kind in CONTAINERS and look.label == title]
        saying = {look.parent for _, look in shown if title in html.unescape(look.content)}
        (part,) = titled or saying
        self._turn_to(part)
        return PageOf(self._controls, part, self._wait)

    # What there is.
    def html(self) -> str:
        """Return all markup that is shown."""
        return "\n".join(look.content for _, look in self._shown() if look.content)

    def text(self) -> str:
        """Return all markup that is shown, as it is read."""
        return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", self.html())).split())

    @property
    def labels(self) -> list[str]:
        """All that stands on or before something."""
        return [look.label.strip() for _, look in self._shown() if look.label]

    @property
    def keys(self) -> list[str]:
        """The keys that do something, wherever they are."""
        return [one.key for one in self._controls.commands]

    def is_shown(self, label: str) -> bool:
        """Whether something has this label, or offers to press it."""
        return any(_is(look, label) for _, look in self._shown())

    def button(self, label: str) -> Look:
        """Return how a button looks, alone or in a row of them."""
        return self._find(label, "button", "choice")[1]

    def value(self, label: str) -> Any:
        """Return what a field holds."""
        return self._find(label, "text", "number", "slider", "timeline", "check", "list")[1].value

    def options(self, label: str) -> tuple[str, ...]:
        """Return what a list offers."""
        return self._find(label, "list")[1].options

    # What a person does.
    def press(self, label: str) -> None:
        """Press a button, alone or in a row of them."""
        id_, look = self._find(label, "button", "choice")
        self._handle(id_, label if look.kind == "choice" else None)

    def drag(self, label: str, by: float) -> None:
        """Drag a button of a list past so many others, up being negative."""
        self._handle(self._find(label, "button")[0], by)

    def press_lead(self, text: str) -> None:
        """Press the first button in the markup that has this text in it."""
        for id_, look in self._shown():
            for press, inside in re.findall(
                r'data-press="(.*?)"[^>]*>(.*?)</button>', look.content
            ):
                if text in html.unescape(re.sub(r"<[^>]*>", "", inside)):
                    self._handle(id_, html.unescape(press))
                    return
        raise AssertionError(f"no {text!r} to press")

    def press_key(self, key: str) -> None:
        """Press a key that does something."""
        (command,) = [one for one in self._controls.commands if one.key == key]
        self._controls.handle(command.id, None)

    def choose(self, label: str, option: str) -> None:
        """Choose something from a list."""
        self._handle(self._find(label, "list")[0], option)

    def type(self, label: str, value: str | float) -> None:
        """Type something into a field, or move a slider."""
        self._handle(self._find(label, "text", "number", "slider", "timeline")[0], value)

    def tick(self, label: str, *, is_on: bool = True) -> None:
        """Tick a box, or take the tick away."""
        self._handle(self._find(label, "check")[0], is_on)

    # Inside.
    def _handle(self, id_: int, value: Any) -> None:
        self._turn_to(id_)
        self._controls.handle(id_, value)

    def _turn_to(self, id_: int) -> None:
        """Open the tab that something is in, as whoever wants to see it has to."""
        while id_ != 0:
            look = self._controls.all[id_].look
            if look.kind == "tab" and self._controls.all[look.parent].look.value != id_:
                self._controls.handle(look.parent, id_)
                self._wait()
            id_ = look.parent

    def _find(self, label: str, *kinds: str) -> tuple[int, Look]:
        found = [one for one in self._shown() if one[1].kind in kinds and _is(one[1], label)]
        assert len(found) == 1, f"{len(found)} of {label!r} among {self.labels}"
        return found[0]

    def _shown(self) -> Iterator[tuple[int, Look]]:
        """Go through what is shown, from top to bottom."""
        brothers: dict[int, list[tuple[float, int, Look]]] = {}
        for id_, control in self._controls.all.items():
            if control.visible:
                look = control.look
                brothers.setdefault(look.parent, []).append((look.order, id_, look))

        def below(parent: int) -> Iterator[tuple[int, Look]]:
            for _, id_, look in sorted(brothers.get(parent, []), key=lambda one: one[:2]):
                yield id_, look
                yield from below(id_)

        return below(self._part)


def page_of(stage: Any, client_id: int = 0) -> PageOf:
    """Return the page of a browser that a pretended viewer has open."""
    return PageOf(stage.page(client_id).controls, wait=lambda: stage.runtime.run(0.3))


def _is(look: Look, label: str) -> bool:
    return label in (look.label.strip(), *(look.options if look.kind == "choice" else ()))
