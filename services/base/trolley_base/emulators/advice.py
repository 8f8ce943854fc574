"""What a robot.toml says to use emulated devices."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import InlineTable

from trolley_base.emulators.arduino_bridge import (
    BATTERY_PIN,
    BATTERY_VOLTS_PER_COUNT,
    BUMPER_PIN,
    CLIFF_PIN,
    ArduinoBridge,
)
from trolley_base.emulators.device import Board, Device
from trolley_base.emulators.hoverboard import GAUGE_M, TIRE_M, Hoverboard
from trolley_base.emulators.lidar import SpinningLidar
from trolley_base.emulators.robot import EmulatedRobot
from trolley_base.emulators.waveshare_ugv import WaveshareUgv


def base_settings(robot: EmulatedRobot) -> str:
    """Return the `[base]` part of a robot.toml for these devices, as TOML.

    If there are several lidars, the first is used.
    """
    base: dict[str, Any] = {"driver": "hardware"}
    for name, device in robot.devices.items():
        kind, port = name.partition("-")[0], str(robot.ports[name].absolute())
        if isinstance(device, Board):
            base["chassis"] = _chassis(robot, device, kind, port)
        elif isinstance(device, SpinningLidar) and "lidar" not in base:
            pose = robot.body.mount.base_T_laser
            where = {"x": pose.x, "y": pose.y, "yaw": pose.yaw}
            base["lidar"] = {"model": kind, "port": port, "pose": _inline(where)}
    return tomlkit.dumps({"base": base})


def _chassis(robot: EmulatedRobot, board: Device, kind: str, port: str) -> dict[str, Any]:
    chassis: dict[str, Any] = {"board": kind, "port": port}
    if isinstance(board, ArduinoBridge):
        wheels = robot.body.wheels
        chassis["wheels"] = {
            "ticks_per_revolution": wheels.ticks_per_revolution,
            "diameter_m": wheels.diameter_m,
            "track_m": wheels.track_m,
        }
        chassis["inputs"] = {
            "bumper_pins": [BUMPER_PIN],
            "cliff_pins": [CLIFF_PIN],
            "battery_pin": BATTERY_PIN,
            "battery_volts_per_count": BATTERY_VOLTS_PER_COUNT,
        }
    elif isinstance(board, Hoverboard):
        chassis["hoverboard"] = {"diameter_m": TIRE_M, "track_m": GAUGE_M}
        chassis["inputs"] = {"battery_empty_v": 35.0, "battery_full_v": 42.0}
    elif isinstance(board, WaveshareUgv):
        chassis["waveshare_ugv"] = {"type": board.robot}
    return chassis


def _inline(values: Mapping[str, float]) -> InlineTable:
    table = tomlkit.inline_table()
    for name, value in values.items():
        table.append(name, value)
    return table


def describe_ports(robot: EmulatedRobot) -> list[str]:
    """Return a line for each port: device, name, terminal, speed."""
    links: dict[str, Path] = dict(robot.ports)
    wide = max(len(name) for name in links)
    far = max(len(f"{links[name]} -> {terminal}") for name, terminal in robot.terminals.items())
    return [
        f"{name:<{wide}}  {f'{links[name]} -> {terminal}':<{far}}  {robot.devices[name].baud} baud"
        for name, terminal in robot.terminals.items()
    ]
