"""How much room a connection has, also one that goes away in this moment."""

import asyncio
import math
import os
import socket
import time
from typing import cast

import pytest
from support.waiting import wait_until

from trolley_viz.server.sending import Room, room_of, silence_of


class Transport:
    """What is asked of an asyncio transport."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def get_extra_info(self, name: str) -> socket.socket:
        assert name == "socket"
        return self._connection

    def get_write_buffer_size(self) -> int:
        return 0


@pytest.fixture
def connection() -> socket.socket:
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = socket.create_connection(server.getsockname())
        server.accept()[0].close()
    return client


def room(connection: socket.socket) -> Room:
    return room_of(cast("asyncio.Transport", Transport(connection)))


def test_a_connection_that_was_closed_waits_for_nothing(connection: socket.socket) -> None:
    connection.close()
    assert room(connection) == Room(0, 0.0)


def test_one_that_the_other_thread_closes_meanwhile_is_closed(connection: socket.socket) -> None:
    # The web server's thread closes it between two looks of the service's.
    os.close(connection.fileno())
    assert room(connection) == Room(0, 0.0)
    connection.detach()


def test_what_came_counts_as_heard_before_anybody_reads_it() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = socket.create_connection(server.getsockname())
        here = server.accept()[0]
    with client, here:
        transport = cast("asyncio.Transport", Transport(here))
        time.sleep(0.3)
        silent_s = silence_of(transport)
        assert silent_s >= 0.25  # since it was opened
        # Again, should this machine look later than that.
        wait_until(lambda: client.send(b"x") and silence_of(transport) < silent_s, "it has come")
        assert here.recv(1) == b"x"


def test_one_that_is_closed_is_silent_for_ever(connection: socket.socket) -> None:
    connection.close()
    assert silence_of(cast("asyncio.Transport", Transport(connection))) == math.inf
