"""How much room a connection has, also one that goes away in this moment."""

import asyncio
import os
import socket
from typing import cast

import pytest

from trolley_viz.server.sending import Room, room_of


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
