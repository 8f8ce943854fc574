"""What each bridge costs while its robot stands and nobody at its other end asks for anything.

    python -m bench.stack.bridges [--seconds 20]

A simulated robot stands; each bridge is started beside it, alone, given time to settle, and its
processor time counted, that of its children too. Foxglove is served by the viewer: what it adds is
the difference to a viewer without it; `bench.mcp.flood` measures an idle chat. The MQTT broker is
Debian's mosquitto and takes what is published; the web address of the webhook answers nothing,
since a robot that stands has no news.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bench.stack.running import cpu_s, tree

from trolley import ports
from trolley.connection import Connection

TROLLEY = str(Path(sys.executable).with_name("trolley"))
ROBOT = "bench"
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
SETTLE_S = 10.0
"""Until a bridge has loaded everything and said all that is new to its other end."""
PATIENCE_S = 120.0


def find_free_port(first: int) -> int:
    """Find a port from `first` on that nobody listens at."""
    return next(one for one in range(first, first + 500) if ports.is_free(one))


@contextmanager
def running(folder: Path, *command: str) -> "Iterator[subprocess.Popen[bytes]]":
    """Run a program, and end it."""
    environment = {**os.environ, "TROLLEY_CONFIG": "", "TROLLEY_STATE": str(folder)}
    with (folder / "log").open("ab") as log:
        process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=log, stderr=log
        )
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def wait_for(endpoint: str, service: str) -> None:
    """Wait until a service is there whose name begins so."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        if ports.is_listening(ports.port_of(endpoint) or 0):
            with Connection([endpoint]) as connection:
                if any(name.startswith(service) for _, name in connection.services(ROBOT)):
                    return
        time.sleep(0.5)
    raise SystemExit(f"{service} did not start")


def share(process: "subprocess.Popen[bytes]", seconds: float) -> float:
    """Measure what part of a core a process and its children take."""
    before_s = {pid: cpu_s(pid) for pid, _ in tree(process.pid)}
    time.sleep(seconds)
    return sum(cpu_s(pid) - used_s for pid, used_s in before_s.items()) / seconds


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    port, viewer, foxglove, broker = (find_free_port(17_000 + 500 * number) for number in range(4))
    endpoint = f"tcp/127.0.0.1:{port}"
    lines = (
        f'[robot]\nname = "{ROBOT}"\nfootprint = {{length_m = 0.4, width_m = 0.3}}\n'
        f'[zenoh]\nconnect = ["{endpoint}"]\n[viz]\nport = {viewer}\n'
    )
    services = {
        "mqtt": ("mqtt", f'[mqtt]\nbroker = "127.0.0.1:{broker}"\n'),
        "webhook": ("mqtt", '[webhook]\nurls = ["http://127.0.0.1:9/"]\n'),
        "viewer": ("viz", ""),
        "viewer with foxglove": ("viz", f"foxglove_port = {foxglove}\n"),
    }
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(
            running(folder, TROLLEY, "demo", "--headless", "--port", str(port), "--name", ROBOT)
        )
        wait_for(endpoint, "tour")
        commands: dict[str, tuple[str, ...]] = {}
        commands["ros2"] = (TROLLEY, "ros2", "--connect", endpoint, "--robot", ROBOT)
        for name, (service, text) in services.items():
            config = folder / f"{name.replace(' ', '-')}.toml"
            config.write_text(lines + text, encoding="utf-8")
            commands[name] = (TROLLEY, "run", service, "--config", str(config))
        if MOSQUITTO is None:
            print("mqtt: not measured, since mosquitto is not installed")
            del commands["mqtt"]
        else:
            stack.enter_context(running(folder, MOSQUITTO, "-p", str(broker)))
        for name, command in commands.items():
            with running(folder, *command) as bridge:
                time.sleep(SETTLE_S)
                if bridge.poll() is not None:
                    raise SystemExit(f"{name} ended: {(folder / 'log').read_text()[-2000:]}")
                print(f"{name}: {100.0 * share(bridge, seconds):.1f} % of a core")
    print("load of this machine: {:.1f}, {:.1f}, {:.1f}".format(*os.getloadavg()))


if __name__ == "__main__":
    main()
