"""Sends the same message repeatedly, many thousand times a second: `bench.faults` starts it.

python -m bench.faults.flood_client ENDPOINT KEY put|get RATE SECONDS < payload
"""

import sys
import time

from trolley.runtime.zenoh_bus import open_bus
from trolley.topics import Qos

TICK_S = 0.005


def main() -> None:
    """Flood, then say how many there were."""
    endpoint, key, how, rate, seconds = sys.argv[1:6]
    payload = sys.stdin.buffer.read()
    sent = 0
    with open_bus([endpoint], 20.0) as bus:
        print("ready", flush=True)
        began_s = time.monotonic()
        while (elapsed_s := time.monotonic() - began_s) < float(seconds):
            due = int(elapsed_s * float(rate)) - sent
            for _ in range(due):
                if how == "put":
                    # As a stranger does: it is dropped where the network is full.
                    bus.put(key, payload, "application/msgpack", Qos.SENSOR)
                else:
                    bus.get(key, payload, "application/msgpack", 1.0, lambda _: None, lambda: None)
            sent += due
            time.sleep(TICK_S)
    print(sent, flush=True)


if __name__ == "__main__":
    main()
