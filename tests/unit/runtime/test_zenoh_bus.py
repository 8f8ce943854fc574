"""A router in which nobody gets a session is opened anew, and its links are read."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from trolley.runtime.uplink_sockets import FarLink
from trolley.runtime.zenoh_bus import (
    MOST_OPENINGS,
    NotConnected,
    _far_links,
    open_answering,
    open_router,
)


class Opened:
    """Knows whether it is open."""

    def __init__(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False


def test_a_socket_in_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "nowhere"
    with (
        pytest.raises(NotConnected, match=f": there is no folder {folder}"),
        open_router([f"unixsock-stream/{folder}/router"]),
    ):
        pass


@pytest.mark.parametrize("num_deaf", [0, 1, MOST_OPENINGS - 1, MOST_OPENINGS + 5])
def test_a_router_in_which_nobody_gets_a_session_is_opened_anew_but_not_for_ever(
    num_deaf: int,
) -> None:
    opened: list[Opened] = []

    def open_one() -> Opened:
        assert not any(one.is_open for one in opened), "its port must be free"
        opened.append(Opened())
        return opened[-1]

    found = open_answering(open_one, lambda: len(opened) > num_deaf)
    assert found is opened[-1]
    assert found.is_open
    assert len(opened) == min(num_deaf + 1, MOST_OPENINGS)


def test_who_is_interrupted_meanwhile_leaves_no_router_open() -> None:
    opened: list[Opened] = []

    def open_one() -> Opened:
        opened.append(Opened())
        return opened[-1]

    def interrupted() -> bool:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        open_answering(open_one, interrupted)
    assert [one.is_open for one in opened] == [False]


def test_a_link_whose_ends_cannot_be_read_is_left_out() -> None:
    """Else the thread that looks after links ends, and revoked hosts keep their places."""
    name = "operator:anna:0123456789abcdef"
    ends = [
        ("tls/127.0.0.1:30000", "tls/[::1]:40000"),
        ("tls/127.0.0.1:30000", "tls/[::1]:40001?rel=1"),
        ("tls/127.0.0.1:30000", "tls/somebody"),
        ("", "tls/127.0.0.1:40002"),
    ]
    links = [SimpleNamespace(src=src, dst=dst, auth_identifier=name) for src, dst in ends]
    session: Any = SimpleNamespace(info=SimpleNamespace(links=lambda: links))
    assert _far_links(session) == [FarLink(30_000, 40_000, name), FarLink(30_000, 40_001, name)]
