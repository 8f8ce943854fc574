"""The `[base]` part of a `robot.toml` that uses what was found."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from trolley_base.detection.found import Found, Seen
from trolley_base.detection.looking import found_of
from trolley_base.detection.ports import Port

CHASSIS, LIDAR = ("base", "chassis"), ("base", "lidar")

WHEELS = """\
Measure these, then take the # away from this line and those below:
board = "arduino_bridge"
[base.chassis.wheels]
ticks_per_revolution = 0  # of the wheel: the encoder's resolution times the gear
diameter_m = 0.0          # of a driven wheel
track_m = 0.0             # between the middles of the left and the right wheel"""
"""What an `arduino_bridge` needs and nobody but its owner knows."""


@dataclass(slots=True)
class Proposal:
    """Settings for what was found.

    Attributes:
        values: by their keys.
        remarks: comments for the end of tables, by the table's keys.
        notes: sentences for the person.
    """

    values: dict[tuple[str, ...], str | int | float] = field(
        default_factory=dict[tuple[str, ...], str | int | float]
    )
    remarks: dict[tuple[str, ...], str] = field(default_factory=dict[tuple[str, ...], str])
    notes: list[str] = field(default_factory=list[str])


def propose(seen: Sequence[Seen], settings: dict[str, Any]) -> Proposal:
    """Choose settings for what was found.

    Args:
        seen: what was found where.
        settings: what the `robot.toml` says already, {} without one.
    """
    proposal = Proposal()
    boards, lidars = found_of(seen, "board"), found_of(seen, "lidar")
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
                "Where the lidar sits is still to be measured: [base.lidar] pose = { x, y, yaw } "
                "and z_m, in metres and radians from the middle between the driven wheels."
            )
    if proposal.values:
        proposal.values = {("base", "driver"): "hardware", **proposal.values}
    return proposal


def render(proposal: Proposal) -> str:
    """Return the settings as TOML."""
    lines: list[str] = []
    tables = dict.fromkeys(keys[:-1] for keys in proposal.values)
    for table in tables:
        lines += ["", f"[{'.'.join(table)}]"]
        lines += [
            f"{keys[-1]} = {_quoted(value)}"
            for keys, value in proposal.values.items()
            if keys[:-1] == table
        ]
        lines += [f"# {line}" for line in proposal.remarks.get(table, "").splitlines()]
    return "\n".join(lines[1:]) + "\n"


def _the_only(
    found: list[tuple[Port, Found]], what: str, proposal: Proposal
) -> tuple[Port, Found] | None:
    """Return the one device of a kind; several are left to the person."""
    if len(found) > 1:
        names = ", ".join(f"{one.title} at {port.name}" for port, one in found)
        proposal.notes.append(
            f"There is more than one {what}: {names}. Name the ports of this robot: "
            f"`trolley detect PORT PORT`."
        )
        return None
    return found[0] if found else None


def _propose_board(proposal: Proposal, port: Port, found: Found, chassis: dict[str, Any]) -> None:
    if found.model == "arduino_bridge" and "wheels" not in chassis:
        proposal.remarks[CHASSIS] = WHEELS
        proposal.notes.append(
            "The wheels are still to be measured: [base.chassis] board stays commented out, and "
            "nothing is driven, until [base.chassis.wheels] says how large they are."
        )
    else:
        proposal.values[*CHASSIS, "board"] = found.model or ""
    proposal.values[*CHASSIS, "port"] = port.name
    _propose_baud(proposal, CHASSIS, found, chassis)


def _propose_baud(
    proposal: Proposal, table: tuple[str, ...], found: Found, present: dict[str, Any]
) -> None:
    """Correct a speed in the file that is not the one at which the device answered."""
    if present.get("baud", found.baud) != found.baud:
        proposal.values[*table, "baud"] = found.baud


def _quoted(value: str | float) -> str:
    """A value as TOML writes it; what stands here are names and whole numbers."""
    return f'"{value}"' if isinstance(value, str) else f"{value}"
