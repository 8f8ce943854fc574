"""Motor boards by their firmware; `trolley detect` reads the same table."""

from trolley.config.hardware import ChassisConfig
from trolley.drivers import Drivers, DriverUnusable, read_settings
from trolley.messages.motion import Drive
from trolley_base.drivers.boards.models import SETTINGS, BoardDriver, BoardFacts
from trolley_base.drivers.dialogue import BoardDialogue
from trolley_base.drivers.interface import DriverError

BOARDS = Drivers(BoardDriver)
"""By the name in `[base.chassis] board`; `trolley detect` tries them in this order."""


def find_board(config: ChassisConfig) -> BoardDriver:
    """Return the driver of the configured board.

    Raises:
        DriverError: none is set, or it cannot be used.
    """
    if config.board is None:
        raise DriverError("[base.chassis] names no board")
    try:
        return BOARDS.find(config.board)
    except DriverUnusable as error:
        raise DriverError(f"[base.chassis] board: {error}") from error


def make_board(config: ChassisConfig, drive: Drive) -> BoardDialogue:
    """Make the dialogue of the configured board.

    A skid-steered robot is driven as a differential one; its wider effective track is a matter of
    `[base.odometry] angular_scale`.

    Raises:
        DriverError: the board cannot do what is configured.
    """
    driver = find_board(config)
    facts, inputs = driver.facts, config.inputs
    is_wired = inputs.bumper_pins or inputs.cliff_pins or inputs.battery_pin is not None
    if is_wired and not facts.has_inputs:
        raise DriverError(
            f"[base.chassis.inputs] names pins, but {facts.title} does not report them; remove them"
        )
    if drive == "mecanum" and not facts.drives_sideways:
        raise DriverError(
            f'[robot] drive = "mecanum" has four motors, and {facts.title} drives two; use '
            "linorobot's firmware"
        )
    for table in driver.needs:
        if getattr(config, table) is None:
            raise DriverError(f"[base.chassis] {config.board} needs the table {table}")
    try:
        read_settings(config.settings, driver.settings, SETTINGS)
        return driver.make(config, config.baud or facts.baud, drive)
    except DriverUnusable as error:
        raise DriverError(str(error)) from error


def counted_track_m(config: ChassisConfig) -> float | None:
    """Return the track that the configured board counts with [m]; None where nothing says it.

    Raises:
        DriverError: the board cannot be used, or not with these settings.
    """
    if config.board is None:
        return None if config.wheels is None else config.wheels.track_m
    try:
        return find_board(config).track_m(config)
    except DriverUnusable as error:
        raise DriverError(str(error)) from error


__all__ = [
    "BOARDS",
    "BoardDriver",
    "BoardFacts",
    "counted_track_m",
    "find_board",
    "make_board",
]
