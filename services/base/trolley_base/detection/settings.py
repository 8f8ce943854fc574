"""The `[base]` part of a `robot.toml` that uses what was found."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
from msgspec import Struct

from trolley.config.describe import Key, as_comment, keys_of, sensor_table, table_of, to_toml
from trolley.config.hardware import ChassisConfig
from trolley.drivers import BoardSensor
from trolley.network_ports import is_network
from trolley_base.detection.detector import devices_of
from trolley_base.detection.ports import Port
from trolley_base.detection.results import FoundDevice, PortResult
from trolley_base.drivers.boards import BOARDS, BoardDriver
from trolley_base.drivers.boards.inputs import wired_sensors
from trolley_base.drivers.lidars import MODELS

CHASSIS, LIDAR = ("base", "chassis"), ("base", "lidar")
USUAL_BAUDS: dict[str | None, int] = {
    **{name: driver.facts.baud for name, driver in MODELS.items()},
    **{name: driver.facts.baud for name, driver in BOARDS.items()},
}
"""What a driver takes where the settings name no speed."""


Settings = dict[tuple[str, ...], str | int | float]


@dataclass(slots=True)
class Proposal:
    """Settings for what was found.

    Attributes:
        values: by their keys.
        waiting: what must be commented out until a person has completed it.
        missing: the settings that a device needs and only its owner knows, by their tables.
        templates: the tables of those, commented out.
        sensor_tables: what lists the board's sensors, with comments; some are commented out.
        sensors: those that are listed.
        notes: sentences for the person.
        sensor_notes: those about what the board feels.
    """

    values: Settings = field(default_factory=Settings)
    waiting: Settings = field(default_factory=Settings)
    missing: dict[tuple[str, ...], list[Key]] = field(
        default_factory=dict[tuple[str, ...], list[Key]]
    )
    templates: list[str] = field(default_factory=list[str])
    sensor_tables: list[str] = field(default_factory=list[str])
    sensors: list[BoardSensor] = field(default_factory=list[BoardSensor])
    notes: list[str] = field(default_factory=list[str])
    sensor_notes: list[str] = field(default_factory=list[str])

    @property
    def tables(self) -> list[str]:
        """Whole tables for the file."""
        return [*self.templates, *self.sensor_tables]


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
        driver = BOARDS[board[1].model or ""]
        chassis = msgspec.convert(base.get("chassis", {}), ChassisConfig)
        _propose_sensors(proposal, driver, board[1], chassis, base.get("scans", {}))
        _check_footprint(proposal, driver, settings.get("robot", {}).get("footprint"))
    if lidar := _the_only(lidars, "lidar", proposal):
        _propose_lidar(proposal, *lidar, base.get("lidar", {}))
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
    return "\n".join(lines[1:]) + "\n" + "".join(f"\n{table}" for table in proposal.tables)


def by_name(proposal: Proposal) -> dict[str, Any]:
    """Return the settings by their names with dots, those of sensors too."""
    found: dict[str, Any] = {".".join(keys): value for keys, value in proposal.values.items()}
    for sensor in proposal.sensors:
        found |= {
            f"base.scans.{sensor.name}.{key}": sensor.settings[key] for key in sensor.settings
        }
    return found


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
    name = found.model or ""
    needs = {table: table_of(ChassisConfig, table) for table in BOARDS[name].needs}
    missing = _missing({**needs, "settings": BOARDS[name].settings}, chassis)
    _propose(proposal, (*CHASSIS, "board"), name, missing, "the robot cannot drive")
    proposal.values[*CHASSIS, "port"] = port.name
    _propose_baud(proposal, CHASSIS, port, found, chassis)


def _propose_lidar(
    proposal: Proposal, port: Port, found: FoundDevice, lidar: dict[str, Any]
) -> None:
    name = found.model or ""
    missing = _missing({"settings": MODELS[name].settings}, lidar)
    _propose(proposal, (*LIDAR, "model"), name, missing, "base does not start")
    proposal.values[*LIDAR, "port"] = port.name
    _propose_baud(proposal, LIDAR, port, found, lidar)


def _propose(
    proposal: Proposal,
    key: tuple[str, str, str],
    name: str,
    missing: dict[str, list[Key]],
    without: str,
) -> None:
    """Name the device, commented out where something is missing that only its owner knows."""
    if not missing:
        proposal.values[key] = name
        return
    proposal.waiting[key] = name
    proposal.missing |= {(*key[:-1], table): keys for table, keys in missing.items()}
    proposal.templates.append(_template(key, name, missing))
    where = ".".join(key[:-1])
    tables = " and ".join(f"[{where}.{table}]" for table in missing)
    proposal.notes.append(
        f"You still have to fill in {tables}: [{where}] {key[-1]} stays commented out, and "
        f"{without}, until it is there."
    )


def _propose_sensors(
    proposal: Proposal,
    driver: BoardDriver,
    found: FoundDevice,
    chassis: ChassisConfig,
    listed: Mapping[str, Any],
) -> None:
    """List what the board feels, unless the file lists some of it already: then its owner chose."""
    sensors = [*driver.sensors, *(wired_sensors(chassis.inputs) if driver.facts.has_inputs else ())]
    if not sensors or any(one.name in listed for one in sensors):
        return
    for one in sensors:
        table = sensor_table(found.model or "", one)
        proposal.sensor_tables.append(table if one.is_usual else as_comment(table))
    proposal.sensors = [one for one in sensors if one.is_usual]
    if proposal.sensors:
        proposal.sensor_notes.append(
            f"What the {found.title} feels is remembered as obstacles: {_names(proposal.sensors)}."
        )
    others = [one for one in sensors if not one.is_usual]
    if others:
        proposal.sensor_notes.append(
            f"Commented out, for you to decide or to fill in: {_names(others)}; "
            "see docs/extra-sensors.md."
        )


def _names(sensors: Sequence[BoardSensor]) -> str:
    return ", ".join(f"[base.scans.{one.name}]" for one in sensors)


def _check_footprint(proposal: Proposal, driver: BoardDriver, footprint: Any) -> None:
    """Say how large a robot is that is known by its board, where the file says otherwise."""
    radius_m = driver.facts.radius_m
    if radius_m is None or footprint is None or footprint == {"radius_m": radius_m}:
        return
    proposal.sensor_notes.append(
        f"A {driver.facts.title} is round: [robot] footprint = {{ radius_m = {radius_m} }}, or "
        "larger if something stands out over its rim. Yours says "
        f"{to_toml(footprint)}."
    )


def _propose_baud(
    proposal: Proposal,
    table: tuple[str, ...],
    port: Port,
    found: FoundDevice,
    present: dict[str, Any],
) -> None:
    """Set the speed at which the device answered, where neither file nor model say it."""
    if is_network(port.name):
        return  # there is none
    if present.get("baud", USUAL_BAUDS.get(found.model, found.baud)) != found.baud:
        proposal.values[*table, "baud"] = found.baud


def _missing(kinds: dict[str, type[Struct]], present: dict[str, Any]) -> dict[str, list[Key]]:
    """Return which keys are required in tables that are not there, by the tables' names."""
    needed = {
        table: [key for key in keys_of(kind) if key.is_required] for table, kind in kinds.items()
    }
    return {table: keys for table, keys in needed.items() if keys and table not in present}


def _template(key: tuple[str, str, str], name: str, missing: dict[str, list[Key]]) -> str:
    """Return the tables that are missing as comments."""
    lines = [f'# Fill this in, then take the # away here and before {key[-1]} = "{name}":']
    for table, keys in missing.items():
        lines.append(f"# [{'.'.join(key[:-1])}.{table}]")
        for one in keys:
            words = f"{one.meaning} ({one.allowed})".replace("`", "")
            lines += textwrap.wrap(words, 94, initial_indent="# # ", subsequent_indent="# # ")
            lines.append(f"# {one.name} = {one.placeholder}")
    return "\n".join(lines) + "\n"
