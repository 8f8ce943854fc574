"""Motor board, lidar and where it sits, of a linorobot's launch files.

Source:
    linorobot, launch/bringup.launch and launch/include/lidar/; rplidar_ros, src/node.cpp;
    ldlidar_stl_ros, src/demo.cpp.
"""

import math

from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.lidars import MODELS
from trolley_base.importers.findings import Value
from trolley_base.importers.linorobot.findings import LinorobotFindings, first
from trolley_base.importers.linorobot.launch_files import FALSE, TRUE
from trolley_base.importers.linorobot.mounting import find_mount

DRIVES = {"2wd": "differential", "4wd": "skid_steer", "mecanum": "mecanum"}
"""What `LINOBASE` may be; it knows Ackermann steering too, which Trolley does not."""
LIDARS: dict[str, str] = {
    name: model for model, driver in MODELS.items() for name in driver.linorobot_names
}
"""What `LINOLIDAR` may be, and what it is to Trolley."""
PACKAGES: dict[str, str] = {
    package: model for model, driver in MODELS.items() for package in driver.ros_packages
}
"""The ROS packages that drive a lidar, and which one."""
ROSSERIAL = ("rosserial_python", "rosserial_server")
MIRRORS: dict[str | None, tuple[str, tuple[str, ...]]] = {
    "rplidar_a1": ("inverted", TRUE),
    "ld19": ("laser_scan_dir", FALSE),
}
"""By which parameter a lidar's ROS driver mirrors its scan, as one that hangs upside down needs."""
MOST_HEIGHT_M = 3.0


def take_hardware(findings: LinorobotFindings, base: str, lidar: str) -> None:
    """Take everything.

    Args:
        findings: is added to.
        base: `LINOBASE`; "" if unknown.
        lidar: `LINOLIDAR`; "" if unknown.
    """
    findings.set("base.driver", "hardware")
    _take_drive(findings, base)
    if not base or base in DRIVES:
        _take_board(findings)
    model = _take_lidar(findings, lidar)
    _take_mount(findings, model)


def _take_drive(findings: LinorobotFindings, base: str) -> None:
    if base in DRIVES:
        findings.set("robot.drive", DRIVES[base])
        findings.taken.append((f"drive {DRIVES[base]}", f"LINOBASE={base}"))
    elif base:
        findings.note(f"Trolley cannot drive a base of the kind {base}: no motor board is set.")
    else:
        findings.note(
            "LINOBASE is not set, so the drive is assumed to be differential (2wd); for another "
            "one give --base 4wd or --base mecanum."
        )


def _take_board(findings: LinorobotFindings) -> None:
    nodes = findings.launch.of_package(ROSSERIAL)
    port = first(nodes, ("port", "_port"))
    findings.set("base.chassis.board", "linorobot")
    if port is None:
        findings.note("No port of the motor board was found: `trolley detect --write` finds it.")
        return
    findings.take("base.chassis.port", port.value, f"motor board at {port.value}", port)
    baud = _baud(first(nodes, ("baud", "_baud")))
    if baud is not None and baud.value != BOARDS["linorobot"].facts.baud:
        findings.take("base.chassis.baud", baud.value, f"its line at {baud.value} baud", baud)


def _take_lidar(findings: LinorobotFindings, lidar: str) -> str | None:
    """Take the lidar; return its model."""
    nodes = findings.launch.of_package(tuple(PACKAGES))
    model = PACKAGES[nodes[0].package] if nodes else LIDARS.get(lidar)
    if model is None:
        what = f"the lidar {lidar}" if lidar else "which lidar it is (LINOLIDAR is not set)"
        findings.note(
            f"Trolley does not know {what}: `trolley detect --write` finds it, or give --lidar "
            f"with one of {', '.join(LIDARS)}."
        )
        return None
    baud = _baud(first(nodes, ("serial_baudrate", "baudrate", "baud_rate", "serial_baud")))
    if baud is not None and baud.value != MODELS[model].facts.baud:
        place = findings.place(baud)
        if model == "rplidar_a1":
            findings.note(
                f"{place}: an RPLIDAR that talks at {baud.value} baud is not an A1: "
                "`trolley detect --write` finds out which it is."
            )
            return None
        if model == "ydlidar_x4":
            findings.note(
                f"{place}: linorobot opens the YDLIDAR at {baud.value} baud, but an X4 talks at "
                f"{MODELS[model].facts.baud}; Trolley uses that."
            )
        else:
            findings.take("base.lidar.baud", baud.value, f"its line at {baud.value} baud", baud)
    findings.set("base.lidar.model", model)
    where = findings.place(nodes[0].arguments) if nodes else f"LINOLIDAR={lidar}"
    findings.taken.append((f"lidar {model}", where))
    port = first(nodes, ("serial_port", "port"))
    if port is not None:
        findings.take("base.lidar.port", port.value, f"lidar at {port.value}", port)
    else:
        findings.note("No port of the lidar was found: `trolley detect --write` finds it.")
    return model


def _take_mount(findings: LinorobotFindings, model: str | None) -> None:
    mount = find_mount(findings.launch, findings.notes)
    if mount is None:
        findings.note(
            "Where the lidar sits was not found: it is assumed to be in the middle between the "
            "wheels, 0.2 m high, facing forward. Measure it and correct [base.lidar] pose and "
            "z_m."
        )
        return
    yaw = mount.yaw
    if model == "rplidar_a1":
        # rplidar_ros publishes the angle pi - the sensor's own.
        yaw = math.remainder(yaw + math.pi, math.tau)
        findings.note(
            "ROS's driver of the RPLIDAR counts angles from the side opposite to the sensor's "
            "zero, so the lidar's yaw is turned by 180°."
        )
    elif model is not None and model.startswith("ydlidar"):
        yaw = _ydlidar_yaw(findings, yaw)
    pose = {"x": round(mount.x_m, 6), "y": round(mount.y_m, 6), "yaw": round(yaw, 6)}
    words = (
        f"lidar mounted at x {mount.x_m:.3f} m, y {mount.y_m:.3f} m, z {mount.z_m:.3f} m, "
        f"{math.degrees(yaw):.1f}°"
    )
    findings.take("base.lidar.pose", pose, words, *mount.sources)
    findings.set("base.lidar.z_m", round(min(max(mount.z_m, 0.0), MOST_HEIGHT_M), 6))
    if mount.is_upside_down != _is_mirrored(findings, model):
        findings.set("base.lidar.upside_down", True)
        findings.note("The lidar is mounted upside down.")
    findings.note(
        "Drivers count a lidar's angles differently: check in the viewer that the scan lies on "
        "the walls; if not, correct [base.lidar] pose."
    )


def _is_mirrored(findings: LinorobotFindings, model: str | None) -> bool:
    """Say whether the lidar's ROS driver is told to mirror its scan."""
    name, mirrors = MIRRORS.get(model, ("", ()))
    given = first(findings.launch.of_package(tuple(PACKAGES)), (name,))
    if given is None or str(given.value).strip().lower() not in mirrors:
        return False
    findings.note(
        f"{findings.place(given)}: `{name}` mirrors the scan, as if the lidar were turned over."
    )
    return True


def _ydlidar_yaw(findings: LinorobotFindings, yaw: float) -> float:
    """Return the yaw of a YDLIDAR whose ROS driver may turn its angles by 180 degrees."""
    given = first(findings.launch.of_package(tuple(PACKAGES)), ("reversion",))
    if given is None:
        findings.note(
            "ROS's driver of the YDLIDAR turns its angles by 180° where its parameter `reversion` "
            "is true, which is not set here: if the scan lies backwards, add 3.14159 to the "
            "lidar's yaw."
        )
        return yaw
    if str(given.value).strip().lower() not in ("true", "1"):
        return yaw
    findings.note(
        f"{findings.place(given)}: `reversion` turns the YDLIDAR's angles by 180°, so the lidar's "
        "yaw is turned by 180°."
    )
    return math.remainder(yaw + math.pi, math.tau)


def _baud(given: Value | None) -> Value | None:
    """Return a baud rate as a whole number, None where it is none."""
    text = "" if given is None else str(given.value).strip()
    return given._replace(value=int(text)) if given is not None and text.isdecimal() else None
