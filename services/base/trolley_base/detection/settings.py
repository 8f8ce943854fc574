"""The `[base]` part of a `robot.toml` that uses what was found."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from trolley.config.describe import to_toml
from trolley_base.detection.detector import devices_of
from trolley_base.detection.ports import Port
from trolley_base.detection.results import FoundDevice, PortResult
from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.lidars import MODELS

CHASSIS, LIDAR = ("base", "chassis"), ("base", "lidar")
USUAL_BAUDS: dict[str | None, int] = {
    **{name: driver.facts.baud for name, driver in MODELS.items()},
    **{name: facts.baud for name, facts in BOARDS.items()},
}
"""What a driver takes where the settings name no speed."""


class Missing(NamedTuple):
    """What a board needs and only its owner knows.

    Attributes:
        table: of `[base.chassis]`, which says it.
        template: that table as comments.
        note: a sentence about what is to be done.
    """

    table: str
    template: str
    note: str


MISSING = {
    "arduino_bridge": Missing(
        "wheels",
        """\
# Measure these, then take the # away here and before board = "arduino_bridge":
# [base.chassis.wheels]
# ticks_per_revolution = 0  # of the wheel: the encoder's resolution times the gear
# diameter_m = 0.0          # of a driven wheel
# track_m = 0.0             # between the middles of the left and the right wheel
""",
        "You still have to measure the wheels: [base.chassis] board stays commented out, and the "
        "robot cannot drive, until [base.chassis.wheels] says how large they are.",
    ),
    "hoverboard": Missing(
        "hoverboard",
        """\
# Measure these, then take the # away here and before board = "hoverboard":
# [base.chassis.hoverboard]
# diameter_m = 0.0          # of a wheel, about 0.165
# track_m = 0.0             # between the middles of both wheels
""",
        "You still have to measure the wheels: [base.chassis] board stays commented out, and the "
        "robot cannot drive, until [base.chassis.hoverboard] says how large they are.",
    ),
    "waveshare_ugv": Missing(
        "waveshare_ugv",
        """\
# Say which robot it is, then take the # away here and before board = "waveshare_ugv":
# [base.chassis.waveshare_ugv]
# type = "ugv_rover"        # or "ugv_beast", which has tracks
""",
        "You still have to say which robot the board is in: [base.chassis] board stays commented "
        "out, and the robot cannot drive, until [base.chassis.waveshare_ugv] type says it.",
    ),
}

Settings = dict[tuple[str, ...], str | int | float]


@dataclass(slots=True)
class Proposal:
    """Settings for what was found.

    Attributes:
        values: by their keys.
        waiting: what must be commented out until a person has completed it.
        appendix: comments that say what to add.
        notes: sentences for the person.
    """

    values: Settings = field(default_factory=Settings)
    waiting: Settings = field(default_factory=Settings)
    appendix: str = ""
    notes: list[str] = field(default_factory=list[str])


def propose(seen: Sequence[PortResult], settings: dict[str, Any]) -> Proposal:
    """Choose settings for what was found.

    Args:
        seen: what was found where.
        settings: what the `robot.toml` says already, {} without one.
    """
    proposal = Proposal()
    boards, lidars = devices_of(seen, "board"), devices_of(seen, "lidar")
    base: dict[str, Any] = settings.get("base", {})
    if board := _the_only(boards, "motor board", proposal):
        _propose_board(proposal, *board, base.get("chassis", {}))
    if lidar := _the_only(lidars, "lidar", proposal):
        port, found = lidar
        proposal.values[*LIDAR, "model"] = found.model or ""
        proposal.values[*LIDAR, "port"] = port.name
        _propose_baud(proposal, LIDAR, found, base.get("lidar", {}))
        if "pose" not in base.get("lidar", {}):
            proposal.notes.append(
                "You still have to measure where the lidar sits: [base.lidar] pose = { x, y, yaw } "
                "and z_m, in metres and radians from the middle between the driven wheels."
            )
    if proposal.values:
        proposal.values = {("base", "driver"): "hardware", **proposal.values}
    return proposal


def render(proposal: Proposal) -> str:
    """Return the settings as TOML."""
    lines: list[str] = []
    for table in dict.fromkeys(keys[:-1] for keys in proposal.values):
        lines += ["", f"[{'.'.join(table)}]"]
        for settings, mark in ((proposal.waiting, "# "), (proposal.values, "")):
            lines += [
                f"{mark}{keys[-1]} = {to_toml(value)}"
                for keys, value in settings.items()
                if keys[:-1] == table
            ]
    appendix = f"\n{proposal.appendix}" if proposal.appendix else ""
    return "\n".join(lines[1:]) + "\n" + appendix


def _the_only(
    found: list[tuple[Port, FoundDevice]], what: str, proposal: Proposal
) -> tuple[Port, FoundDevice] | None:
    """Return the one device of a kind; several are left to the person."""
    if len(found) > 1:
        names = ", ".join(f"{one.title} at {port.name}" for port, one in found)
        proposal.notes.append(
            f"There is more than one {what}: {names}. Name the ports of this robot: "
            f"`trolley detect PORT PORT`."
        )
        return None
    return found[0] if found else None


def _propose_board(
    proposal: Proposal, port: Port, found: FoundDevice, chassis: dict[str, Any]
) -> None:
    missing = MISSING.get(found.model or "")
    if found.model is not None and missing is not None and missing.table not in chassis:
        proposal.waiting[*CHASSIS, "board"] = found.model
        proposal.appendix = missing.template
        proposal.notes.append(missing.note)
    else:
        proposal.values[*CHASSIS, "board"] = found.model or ""
    proposal.values[*CHASSIS, "port"] = port.name
    _propose_baud(proposal, CHASSIS, found, chassis)


def _propose_baud(
    proposal: Proposal, table: tuple[str, ...], found: FoundDevice, present: dict[str, Any]
) -> None:
    """Set the speed at which the device answered, where neither file nor model say it."""
    if present.get("baud", USUAL_BAUDS.get(found.model, found.baud)) != found.baud:
        proposal.values[*table, "baud"] = found.baud
