"""Motor boards by their firmware."""

import math
from dataclasses import dataclass
from typing import TypeVar

from trolley.config.hardware import Board, ChassisConfig
from trolley.messages.motion import Drive
from trolley_base.drivers.boards.arduino_bridge import ArduinoBridgeDialogue
from trolley_base.drivers.boards.create2 import Create2Dialogue
from trolley_base.drivers.boards.hoverboard import HoverboardDialogue
from trolley_base.drivers.boards.linorobot import LinorobotDialogue
from trolley_base.drivers.boards.linorobot2 import Linorobot2Dialogue
from trolley_base.drivers.boards.waveshare_ugv import WATCHDOG_MS, WaveshareUgvDialogue
from trolley_base.drivers.dialogue import BoardDialogue
from trolley_base.drivers.interface import DriverError

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class BoardFacts:
    """What is known of a firmware.

    Attributes:
        title: how people call it.
        baud: bits per second, if the firmware was not changed.
        watchdog_s: after what silence it stops the motors by itself [s], as delivered or as it is
            told on each connection; infinite where it never does.
        has_imu: it can report an inertial sensor.
        has_inputs: its pins can be read: bumpers, cliff sensors, a battery.
    """

    title: str
    baud: int
    watchdog_s: float
    has_imu: bool
    has_inputs: bool


BOARDS: dict[Board, BoardFacts] = {
    "linorobot": BoardFacts("linorobot (Teensy)", 57600, 0.4, has_imu=True, has_inputs=False),
    "linorobot2": BoardFacts(
        "linorobot2 (micro-ROS)", 115200, math.inf, has_imu=True, has_inputs=False
    ),
    "arduino_bridge": BoardFacts(
        "ROSArduinoBridge (Arduino)", 57600, 2.0, has_imu=False, has_inputs=True
    ),
    "waveshare_ugv": BoardFacts(
        "Waveshare UGV (ESP32)", 115200, WATCHDOG_MS * 1e-3, has_imu=False, has_inputs=False
    ),
    "create2": BoardFacts("Create 2 or Roomba", 115200, math.inf, has_imu=False, has_inputs=False),
    "hoverboard": BoardFacts(
        "hoverboard (FOC firmware)", 115200, 0.8, has_imu=False, has_inputs=False
    ),
}


def make_board(config: ChassisConfig, drive: Drive) -> BoardDialogue:
    """Make the dialogue of the configured board.

    A skid-steered robot is driven as a differential one; its wider effective track is a matter of
    `[base.odometry] angular_scale`.

    Raises:
        DriverError: the board cannot do what is configured.
    """
    if config.board is None:
        raise DriverError("[base.chassis] names no board")
    facts, inputs = BOARDS[config.board], config.inputs
    baud = config.baud or facts.baud
    is_wired = inputs.bumper_pins or inputs.cliff_pins or inputs.battery_pin is not None
    if is_wired and not facts.has_inputs:
        raise DriverError(
            f"[base.chassis.inputs] names pins, but {facts.title} does not report them; remove them"
        )
    if config.board == "linorobot":
        return LinorobotDialogue(config, baud, can_drive_sideways=drive == "mecanum")
    if config.board == "linorobot2":
        return Linorobot2Dialogue(config, baud, can_drive_sideways=drive == "mecanum")
    if drive == "mecanum":
        raise DriverError(
            f'[robot] drive = "mecanum" has four motors, and {facts.title} drives two; use '
            "linorobot's firmware"
        )
    if config.board == "waveshare_ugv":
        return WaveshareUgvDialogue(config, _needed(config.waveshare_ugv, config.board), baud)
    if config.board == "create2":
        return Create2Dialogue(config, baud)
    if config.board == "hoverboard":
        return HoverboardDialogue(config, _needed(config.hoverboard, config.board), baud)
    return ArduinoBridgeDialogue(config, _needed(config.wheels, "wheels"), baud)


def _needed(table: T | None, name: str) -> T:
    """Return a table of `[base.chassis]` without which there is no dialogue."""
    if table is None:
        raise DriverError(f"[base.chassis] needs the table [base.chassis.{name}]")
    return table


__all__ = ["BOARDS", "BoardFacts", "make_board"]
