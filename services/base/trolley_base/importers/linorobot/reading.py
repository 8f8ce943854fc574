"""Reads all files of a linorobot's package."""

from pathlib import Path

from trolley_base.importers.linorobot.findings import LinorobotFindings
from trolley_base.importers.linorobot.hardware import take_hardware
from trolley_base.importers.linorobot.launch_files import Launch, LaunchReader
from trolley_base.importers.linorobot.navigation import take_navigation

LAUNCH_FILES = ("bringup.launch", "navigate.launch")
ELSEWHERE = {"amcl": ("amcl.launch",), "static_transform_publisher": ("laser.launch", "tf.launch")}
"""Where programs are started that the two do not lead to, in the versions of linorobot."""


def read_linorobot(folder: Path, base: str, lidar: str) -> LinorobotFindings:
    """Find out what a linorobot's files say of the robot.

    Args:
        folder: its package, which holds `launch`, `param` and `maps`, or some files of them.
        base: `LINOBASE`, such as 2wd; "" if unknown.
        lidar: `LINOLIDAR`, such as rplidar; "" if unknown.
    """
    environment = {"LINOBASE": base, "LINOLIDAR": lidar}
    reader = LaunchReader(folder, {name: text for name, text in environment.items() if text})
    launch = Launch()
    for name in LAUNCH_FILES:
        path = _find(folder, name)
        if path is None:
            launch.problems.append(f"There is no {name}.")
        else:
            reader.read(path, launch)
    for kind, names in ELSEWHERE.items():
        for path in filter(None, (_find(folder, name) for name in names)):
            if not launch.of_kind(kind):
                reader.read(path, launch)
    findings = LinorobotFindings(folder, launch=launch)
    findings.notes.extend(launch.problems)
    take_navigation(findings, base)
    take_hardware(findings, base, lidar)
    return findings


def _find(folder: Path, name: str) -> Path | None:
    """Return the file of a name in a folder or below, the one that lies least deep."""
    found = sorted(folder.rglob(name), key=lambda path: (len(path.parts), path))
    return found[0] if found else None
