"""Reads all files of a linorobot's package."""

from pathlib import Path

from trolley_base.linorobot.findings import Findings
from trolley_base.linorobot.hardware import take_hardware
from trolley_base.linorobot.launch_files import Launch, LaunchReader
from trolley_base.linorobot.navigation import take_navigation

LAUNCH_FILES = ("launch/bringup.launch", "launch/navigate.launch")
# Where programs are started that the two do not lead to, in the versions of linorobot.
ELSEWHERE = {
    "amcl": ("launch/include/amcl.launch", "launch/amcl.launch"),
    "static_transform_publisher": (
        "launch/include/laser.launch",
        "launch/include/tf.launch",
        "launch/laser.launch",
        "launch/tf.launch",
    ),
}


def read_linorobot(folder: Path, base: str, lidar: str) -> Findings:
    """Find out what a linorobot's files say of the robot.

    Args:
        folder: its package, which holds `launch`, `param` and `maps`.
        base: `LINOBASE`, such as 2wd; "" if unknown.
        lidar: `LINOLIDAR`, such as rplidar; "" if unknown.
    """
    environment = {"LINOBASE": base, "LINOLIDAR": lidar}
    reader = LaunchReader(folder, {name: text for name, text in environment.items() if text})
    launch = Launch()
    for name in LAUNCH_FILES:
        if (folder / name).is_file():
            reader.read(folder / name, launch)
        else:
            launch.problems.append(f"There is no {name}.")
    for kind, names in ELSEWHERE.items():
        for name in names:
            if not launch.of_kind(kind) and (folder / name).is_file():
                reader.read(folder / name, launch)
    findings = Findings(folder, launch)
    findings.notes.extend(launch.problems)
    take_navigation(findings, base)
    take_hardware(findings, base, lidar)
    return findings
