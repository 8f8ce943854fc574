"""Who listens where."""

import os
import socket

from trolley import ports


def test_a_port_that_is_listened_on_is_taken_and_its_owner_is_named() -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        port = server.getsockname()[1]
        assert not ports.is_free(port)
        assert ports.is_listening(port)
        owner = ports.owner(port)
        assert owner is not None
        assert f"(pid {os.getpid()})" in owner
        assert ports.first_free(port) > port
    assert ports.is_free(port)
    assert not ports.is_listening(port)
    assert ports.owner(port) is None
