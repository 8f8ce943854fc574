"""What a robot.toml says to use emulated devices."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import InlineTable

from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.lidars import MODELS
from trolley_base.emulators import catalogue
from trolley_base.emulators.device import Board
from trolley_base.emulators.lidar import SpinningLidar
from trolley_base.emulators.robot import EmulatedRobot


def base_settings(robot: EmulatedRobot) -> str:
    """Return the `[base]` part of a robot.toml for these devices, as TOML.

    If there are several lidars, the first is used.
    """
    base: dict[str, Any] = {"driver": "hardware"}
    for name, device in robot.devices.items():
        address = robot.addresses.get(name)
        kind, port = catalogue.kind_of(name), address or str(robot.ports[name].absolute())
        if isinstance(device, Board):
            base["chassis"] = _chassis(robot, device, kind, port)
        elif isinstance(device, SpinningLidar) and "lidar" not in base:
            pose = robot.body.mount.base_T_laser
            where = {"x": pose.x, "y": pose.y, "yaw": pose.yaw}
            example = MODELS[kind].example
            base["lidar"] = {"model": kind, "port": port, "pose": _inline(where), **example}
    return tomlkit.dumps({"base": base})


def _chassis(robot: EmulatedRobot, board: Board, kind: str, port: str) -> dict[str, Any]:
    tables = catalogue.BOARDS[kind].tables(board, robot.body.wheels)
    return {"board": kind, "port": port, **BOARDS[kind].example, **tables}


def _inline(values: Mapping[str, float]) -> InlineTable:
    table = tomlkit.inline_table()
    for name, value in values.items():
        table.append(name, value)
    return table


def describe_ports(robot: EmulatedRobot) -> list[str]:
    """Return a line for each port: device, name, terminal, speed."""
    links: dict[str, Path] = dict(robot.ports)
    wide = max(len(name) for name in robot.devices)
    where = {
        name: f"{links[name]} -> {terminal}" if name in links else terminal
        for name, terminal in robot.terminals.items()
    }
    far = max(map(len, where.values()))
    return [
        f"{name:<{wide}}  {place:<{far}}  "
        + (f"{robot.devices[name].baud} baud" if name in links else "")
        for name, place in where.items()
    ]
