"""What a router's log says of other hosts."""

import logging
from collections.abc import Callable

import pytest

from trolley.runtime.far_links import PATIENCE_S, FarLink, FarLinks
from trolley.runtime.log import Log

UPLINK = ["tls/home.local:7448"]
HOME = FarLink(7448, "router:home:0123456789abcdef")
GUEST = FarLink(40_000, "operator:anna:0123456789abcdef")


@pytest.fixture
def said(caplog: pytest.LogCaptureFixture) -> Callable[[], list[str]]:
    """What has been logged since it was called last."""
    caplog.set_level(logging.INFO)

    def take() -> list[str]:
        messages = [record.getMessage() for record in caplog.records]
        caplog.clear()
        return messages

    return take


def test_the_home_router_is_told_of_when_it_comes_and_once_when_it_stays_away(
    said: Callable[[], list[str]],
) -> None:
    far = FarLinks(UPLINK, Log("router"), 0.0)
    far.update([GUEST], PATIENCE_S - 0.1)
    assert said() == []
    for now_s in (PATIENCE_S, PATIENCE_S + 1.0):
        far.update([], now_s)
    (absent,) = said()
    assert absent.startswith("No link to the home router")
    for now_s in (20.0, 21.0):
        far.update([HOME, GUEST], now_s)
    assert said() == ["Linked to the home router"]
    far.update([], 22.0)
    far.update([HOME], 23.0)
    assert said() == ["Linked to the home router"]


def test_a_router_without_uplink_misses_nobody(said: Callable[[], list[str]]) -> None:
    far = FarLinks([], Log("router"), 0.0)
    far.update([], 2.0 * PATIENCE_S)
    assert said() == []
