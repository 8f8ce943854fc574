"""The pages that are open: their lines come and go, and viser's connections find their page."""

import itertools
import secrets

import viser

from trolley_viz.pages.page import Page, Shared
from trolley_viz.robots.view import View
from trolley_viz.server.lines import Line
from trolley_viz.server.messages import Said
from trolley_viz.server.visitors import Visitor
from trolley_viz.session.hub import Hub

PageName = tuple[str, Visitor]
"""A page's key and who has it open: with the key alone nobody gets at another's page."""


class OpenPages:
    """All pages, from their first connection until nobody comes back to them.

    Args:
        hub: what they share.
        shared: what they share besides.
    """

    def __init__(self, hub: Hub, shared: Shared) -> None:
        self.hub, self._shared = hub, shared
        self.by_name: dict[PageName, Page] = {}
        self._numbers = itertools.count()
        self._unclaimed: dict[str, viser.ClientHandle] = {}
        """viser's connections that no page has claimed yet, by the secret each was given."""

    @property
    def all(self) -> list[Page]:
        """Those that are open, or may come back."""
        return list(self.by_name.values())

    @property
    def is_any_seen(self) -> bool:
        """Whether somebody has one open now."""
        return any(page.is_connected for page in self.all)

    # viser's connections.
    def open_scene(self, client: viser.ClientHandle) -> None:
        """Give a connection of viser's a secret, by which its page claims it."""
        secret = secrets.token_hex(16)
        self._unclaimed[secret] = client
        client.gui.add_html(f'<span id="trolley-scene" data-secret="{secret}"></span>')

    def close_scene(self, client_id: int) -> None:
        """Forget a connection of viser's that is gone."""
        for page in self.all:
            if page.session.window.picture.is_of(client_id):
                page.session.detach()
        for secret, client in tuple(self._unclaimed.items()):
            if client.client_id == client_id:
                del self._unclaimed[secret]

    # Lines.
    def open_line(self, line: Line) -> None:
        """Connect a page, or one that was gone for a moment."""
        page = self.by_name.get(_page_of(line))
        if page is None:
            visitor = line.visitor
            choices = self.hub.browsers.choices_of(visitor.browser)
            page = Page(next(self._numbers), line.key, visitor, choices, self.hub, self._shared)
            self.by_name[_page_of(line)] = page
        page.connect(line, self.hub.service.monotonic_ns)

    def close_line(self, line: Line) -> None:
        """Note that the line to a page is gone."""
        page = self.by_name.get(_page_of(line))
        if page is not None:
            page.disconnect(line)

    def hear(self, line: Line, said: Said) -> None:
        """Do what a page says."""
        page = self.by_name.get(_page_of(line))
        if page is None or not page.is_on(line):
            return
        if said.scene is not None:
            client = self._unclaimed.pop(said.scene, None)
            if client is not None:
                page.session.attach(client)
        page.hear(said, self.hub.service.monotonic_ns)

    # What is done repeatedly.
    def give_up_the_silent(self, now_ns: int) -> bool:
        """Give up pages that say nothing, and forget those that nobody comes back to.

        Returns:
            Whether the last one was forgotten.
        """
        for page in self.all:
            page.give_up_if_silent(now_ns)
        over = [name for name, page in self.by_name.items() if page.is_over(now_ns)]
        for name in over:
            self.by_name.pop(name).close()
        return bool(over) and not self.by_name

    def layers_by_robot(self) -> dict[str, set[str]]:
        """Return the layers that somebody wants to see of each robot that is followed."""
        shown: dict[str, set[str]] = {}
        for page in self.all:
            shown.setdefault(page.robot, set()).update(page.shown_layers())
        return shown

    def update(self) -> None:
        """Tell all what changed."""
        for page in self.all:
            page.update(self._view_of(page))

    def beat(self, now_ns: int) -> None:
        """Let all know that the viewer lives."""
        for page in self.all:
            page.beat(now_ns)

    def _view_of(self, page: Page) -> View:
        return self.hub.scenes.of(page.robot).view


def _page_of(line: Line) -> PageName:
    return line.key, line.visitor
