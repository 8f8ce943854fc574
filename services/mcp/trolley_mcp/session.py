"""A session over stdin and stdout, from the first word to the last."""

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from io import FileIO, RawIOBase
from typing import Any

import anyio
from mcp.server.stdio import stdio_server

from trolley.config.mcp import McpConfig
from trolley.connection import Target
from trolley.runtime.guest import guest
from trolley.runtime.log import Log, set_up_logging
from trolley_mcp.lines import Lines, Written
from trolley_mcp.server import make_server
from trolley_mcp.service import AssistantService

FIRST_CLOCK_S = 1.0
"""How long the first answer waits for the robot's clock; without it the robot seems to be away."""


def talk(robot: str, target: Target, settings: McpConfig) -> None:
    """Serve the assistant until it closes stdin, or asks the program to end.

    Raises:
        NotConnected: No router answers.
    """
    set_up_logging()  # to stderr: stdout is the protocol's
    service = AssistantService()
    with guest(service, robot, target.endpoints, target.keys):
        server = make_server(service.robot_link, settings)

        async def serve() -> None:
            answers: Any = Written(stdout)
            # Of a file it wants nothing but its lines, and of the other two methods.
            lines: Any = Lines(FileIO(0, closefd=False), service.robot_link.stop_now)
            with anyio.CancelScope() as session:
                _on_signal(session.cancel)
                with anyio.move_on_after(FIRST_CLOCK_S):
                    while service.robot_link.now_ns is None:
                        await anyio.sleep(0.02)
                async with stdio_server(stdin=lines, stdout=answers) as (reading, writing):
                    await server.run(reading, writing, server.create_initialization_options())

        with _stdout() as stdout:
            try:
                anyio.run(serve)
            except* BrokenPipeError:
                Log(service.name).info("The assistant reads no more: the session ends")


def _on_signal(end: Callable[[], None]) -> None:
    """Call it when asked to end other than by Ctrl-C, which cancels what is under way by itself.

    Signals that are ignored stay so, as under `nohup`.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            asyncio.get_running_loop().add_signal_handler(number, end)


@contextmanager
def _stdout() -> Generator[RawIOBase]:
    """The protocol's stdout; what anything else prints meanwhile goes to stderr."""
    sys.stdout.flush()
    with FileIO(os.dup(1), "w") as stdout:
        os.dup2(2, 1)
        try:
            yield stdout
        finally:
            os.dup2(stdout.fileno(), 1)
