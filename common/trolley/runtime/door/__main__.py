"""Runs the door: `python -m trolley.runtime.door FILE HOST PORT...`; `keeper.py` starts it.

FILE is the number of the listening socket that was handed down, HOST and PORTs are the router's.
"""

import asyncio
import socket
import sys

from trolley.runtime.door.admission import Limits
from trolley.runtime.door.server import Door
from trolley.runtime.log import set_up_logging
from trolley.runtime.open_files import allow_many_files
from trolley.supervision import end_with_parent


async def _main() -> None:
    file, host, *ports = sys.argv[1:]
    with socket.socket(fileno=int(file)) as listener:
        limits = Limits().within(allow_many_files())
        await Door(listener, [(host, int(port)) for port in ports], limits).run()


end_with_parent()
set_up_logging()
asyncio.run(_main())
