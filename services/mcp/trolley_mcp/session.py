"""A session over stdin and stdout, from the first word to the last."""

import sys
from typing import Any

import anyio
from mcp.server.stdio import stdio_server

from trolley.config.mcp import McpConfig
from trolley.connection import Target
from trolley.runtime.guest import guest
from trolley.runtime.log import set_up_logging
from trolley_mcp.lines import Lines
from trolley_mcp.server import make_server
from trolley_mcp.service import AssistantService


def talk(robot: str, target: Target, settings: McpConfig) -> None:
    """Serve the assistant until it closes stdin.

    Raises:
        NotConnected: No router answers.
    """
    set_up_logging()  # to stderr: stdout is the protocol's
    service = AssistantService()
    with guest(service, robot, target.endpoints, target.keys):
        server = make_server(service.robot_link, settings)

        async def serve() -> None:
            # Of a file it wants nothing but its lines.
            lines: Any = Lines(sys.stdin.buffer, service.robot_link.stop_now)
            async with stdio_server(stdin=lines) as (reading, writing):
                await server.run(reading, writing, server.create_initialization_options())

        anyio.run(serve)
