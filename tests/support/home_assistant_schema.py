"""Judges discovery messages by Home Assistant's own schemas, in a Python that has it installed.

    python home_assistant_schema.py < {"vacuum/vacuum": {…}, …}

It prints what each schema has against a message; nothing where all fit.
"""

import importlib
import json
import sys


def main() -> None:
    """Check what comes on standard input."""
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
            module.DISCOVERY_SCHEMA(message)
        except invalid as error:
            sys.stdout.write(f"{address}: {error}\n")


main()
