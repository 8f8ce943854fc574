"""Judges discovery messages by Home Assistant's own schemas, in a Python that has it installed.

    python home_assistant_schema.py < {"vacuum/vacuum": {…}, …}

It prints what each schema has against a message, and the keys that it does not know; nothing where
all fit.
"""

import asyncio
import importlib
import json
import sys
import tempfile


async def main() -> None:
    """Check what comes on standard input."""
    core, frame = (
        importlib.import_module(f"homeassistant.{one}") for one in ("core", "helpers.frame")
    )
    # Later versions than 2024.3 look for the running Home Assistant as they read a template.
    home = core.HomeAssistant(tempfile.gettempdir())
    if hasattr(frame, "async_setup"):
        frame.async_setup(home)
    invalid = importlib.import_module("voluptuous").Invalid
    for address, message in json.load(sys.stdin).items():
        component = address.split("/")[0]
        module = importlib.import_module(f"homeassistant.components.mqtt.{component}")
        root = message.pop("~")
        for part in (message, *message["availability"]):
            for key, value in part.items():
                if isinstance(value, str) and value.startswith("~"):
                    part[key] = root + value[1:]
        try:
            understood = module.DISCOVERY_SCHEMA(message)
        except invalid as error:
            sys.stdout.write(f"{address}: {error}\n")
        else:
            for key in sorted(message.keys() - understood.keys()):
                sys.stdout.write(f"{address}: unknown key {key}\n")


asyncio.run(main())
