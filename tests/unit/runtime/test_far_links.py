"""What a router's log says of other hosts."""

import logging
from collections.abc import Callable

import pytest

from trolley.runtime.far_links import LASTING_S, PATIENCE_S, FarLinks
from trolley.runtime.log import Log
from trolley.runtime.uplink_sockets import FarLink

UPLINK = ["tls/home.local:7448"]
HOME = FarLink(41_000, 7448, "router:home:0123456789abcdef")
GUEST = FarLink(30_000, 40_000, "operator:anna:0123456789abcdef")


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
    far = FarLinks(UPLINK, [GUEST.certificate], Log("router"), 0.0)
    far.update([GUEST], PATIENCE_S - 0.1)
    assert said() == []
    for now_s in (PATIENCE_S, PATIENCE_S + 1.0):
        far.update([], now_s)
    (absent,) = said()
    assert absent.startswith("No link to the home router")
    for i in range(60):  # it is accepted and sent away, again and again
        far.update([HOME] if i % 3 else [], 20.0 + 0.5 * i)
    assert said() == []
    for now_s in (60.0, 60.0 + LASTING_S, 70.0):
        far.update([HOME, GUEST], now_s)
    assert said() == ["Linked to the home router"]
    far.update([], 71.0)
    for now_s in (72.0, 72.0 + LASTING_S):
        far.update([HOME], now_s)
    assert said() == []


def test_a_router_without_uplink_misses_nobody(said: Callable[[], list[str]]) -> None:
    far = FarLinks([], [], Log("router"), 0.0)
    far.update([], 2.0 * PATIENCE_S)
    assert said() == []


def test_who_is_not_let_in_has_to_go_and_is_told_of_once(said: Callable[[], list[str]]) -> None:
    """One with a revoked certificate kept its place at the door, and the log did not know."""
    thief = FarLink(30_000, 40_001, "operator:anna:fedcba9876543210")
    far = FarLinks(UPLINK, [GUEST.certificate], Log("router"), 0.0)
    assert far.update([HOME, GUEST], 0.5) == []
    for now_s in (1.0, 1.5):
        assert far.update([HOME, GUEST, thief], now_s) == [thief]
    assert said() == ["A host that is not in allowed.pem is sent away"]
