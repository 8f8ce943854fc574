"""Which sockets of a router give up early when the network is gone."""

import socket

import pytest
from support.files import no_files_left

from trolley.runtime.uplink_sockets import (
    LOOK_S,
    UNANSWERED_MS,
    given_up_when_unanswered,
    limit_waiting,
)


def _limit_of(link: socket.socket) -> int:
    return link.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


@pytest.fixture
def listening():
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def test_both_ends_of_a_far_connection_get_the_limit(listening: socket.socket):
    port = listening.getsockname()[1]
    with (
        socket.create_connection(("127.0.0.1", port)) as mine,
        socket.create_server(("127.0.0.1", 0)) as other_server,
        socket.create_connection(other_server.getsockname()) as other,
    ):
        known = limit_waiting({port})
        assert _limit_of(mine) == UNANSWERED_MS
        assert _limit_of(other) == 0
        accepted, _ = listening.accept()
        with accepted:
            assert limit_waiting({port}, known) > known
            assert _limit_of(accepted) == UNANSWERED_MS


def test_one_that_still_connects_is_looked_at_again(listening: socket.socket):
    port = listening.getsockname()[1]
    with socket.socket() as mine:
        known = limit_waiting({port})
        mine.connect(("127.0.0.1", port))
        limit_waiting({port}, known)
        assert _limit_of(mine) == UNANSWERED_MS


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        ("tls/127.0.0.1:{}", UNANSWERED_MS),
        ("tls/[::1]:{}?rel=1#iface=lo", UNANSWERED_MS),
        ("tcp/127.0.0.1:{}", 0),
    ],
)
def test_only_connections_with_other_hosts_are_given_up(
    listening: socket.socket, endpoint: str, expected: int
):
    port = listening.getsockname()[1]
    with given_up_when_unanswered([endpoint.format(port)]):
        ended = LOOK_S * 20
        while _limit_of(listening) != expected and ended > 0:
            ended -= LOOK_S / 10
            listening.settimeout(LOOK_S / 10)
            with pytest.raises(TimeoutError):
                listening.accept()
    assert _limit_of(listening) == expected


def test_a_router_without_a_file_left_looks_again_later(listening: socket.socket):
    port = listening.getsockname()[1]
    known = limit_waiting({port})
    with socket.create_connection(("127.0.0.1", port)) as mine:
        with no_files_left():
            assert limit_waiting({port}, known) == known
        limit_waiting({port}, known)
        assert _limit_of(mine) == UNANSWERED_MS
