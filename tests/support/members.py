"""The members of the workspace beside `common`."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MEMBERS = tuple(sorted(path.parent.name for path in ROOT.glob("services/*/pyproject.toml")))
"""The folders in `services/`."""
WITHOUT_SERVICE = {
    "mcp": "a chat assistant starts it, by `trolley mcp`, on any host",
    "ros2": "who uses ROS 2 starts it, by `trolley ros2`, on any host",
}
"""Members that are no service of a robot, which `trolley up` starts, and why; each is a command."""
SERVICES = tuple(name for name in MEMBERS if name not in WITHOUT_SERVICE)
