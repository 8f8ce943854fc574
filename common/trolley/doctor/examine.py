"""Gathers the facts of all checks and puts the findings together."""

import dataclasses
import datetime
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from trolley import ports
from trolley.config import ConfigError, HostConfig, RobotConfig, find_config, load_host_config
from trolley.connection import Connection, RobotUnreachable, RouterBusy, Target
from trolley.doctor import (
    certificates,
    computer,
    computer_facts,
    devices,
    endpoints,
    rights,
    settings,
    trial,
    units,
    users,
)
from trolley.doctor.computer_facts import Host
from trolley.doctor.finding import Finding, looked_at, note, problem
from trolley.doctor.robot import check_robot
from trolley.doctor.robot_facts import listen
from trolley.gridmap import GridMap
from trolley.runtime.state import state_root
from trolley.security.host_keys import KEY, KeysError, find_keys
from trolley.suggestions import did_you_mean
from trolley.zones import ZoneFile

UNIT_STATE = Path("/var/lib/trolley")
SERVICE_USER = "trolley"
CACHE_VARIABLE = "NUMBA_CACHE_DIR"


@dataclasses.dataclass(frozen=True)
class Place:
    """What is known of this host before anything is checked."""

    host: Host
    config_path: Path | None
    host_config: HostConfig | None
    """None where there is none, or where it cannot be used."""
    units: list[units.Unit] | None
    user: users.User
    """User that the services run as here."""
    state: Path
    """The state folder of all robots of this host."""

    @property
    def config(self) -> RobotConfig | None:
        """The robot.toml of this host's robot, None where it has none."""
        return self.host_config if isinstance(self.host_config, RobotConfig) else None

    @property
    def robot_state(self) -> Path | None:
        """The state folder of the robot of robot.toml."""
        return None if self.config is None else self.state / self.config.robot.name

    @property
    def bridged_robot(self) -> str | None:
        """The robot of robot.toml, if that gives `mqtt` something to do."""
        if self.config is None or "mqtt" in self.config.idle_services:
            return None
        return self.config.robot.name


def look_around(given: Path | None, host: Host) -> Place:
    """Find configuration, units, and as whom the services run."""
    path = find_config(given)
    try:
        config = None if path is None else load_host_config(path)
    except ConfigError:  # a check of its own says all that is wrong with it
        config = None
    installed = units.read_units(host)
    base = next((unit for unit in installed or [] if unit.service == "base"), None)
    named = None if base is None else users.find_user(base.user or "root")
    if base is None and path is not None and path.is_relative_to("/etc/trolley"):
        named = users.find_user(SERVICE_USER)
    user = named or users.this_user()
    if base is not None:
        user = users.with_groups(user, list(base.groups))
    is_set_up = base is not None and "TROLLEY_STATE" not in os.environ
    return Place(host, path, config, installed, user, UNIT_STATE if is_set_up else state_root())


def examine_host(place: Place) -> list[Finding]:
    """All checks of this computer, whether a robot runs or not."""
    host, config = place.host, place.host_config
    checks: list[tuple[str, Callable[[], list[Finding]]]] = [
        ("system", lambda: computer.check_system(computer_facts.read_system())),
        ("clock", lambda: computer.check_clock(computer_facts.read_clock())),
        ("processor", lambda: computer.check_processor(computer_facts.read_processor(host))),
        ("memory", lambda: _check_memory(host)),
        ("disk", lambda: computer.check_disk(computer_facts.read_disk(place.state))),
        (
            "network",
            lambda: computer.check_loopback(is_up=computer_facts.read_loopback(host)),
        ),
        ("wi-fi", lambda: computer.check_wifi(computer_facts.read_wifi(host))),
        ("settings", lambda: settings.check_file(place.config_path)),
        ("settings", lambda: _check_role(place)),
        ("settings", lambda: _check_kept(place)),
        ("map", lambda: _check_map(place)),
        ("permissions", lambda: _check_rights(place)),
        ("certificates", lambda: certificates.check_keys(config, _now())),
        ("services", lambda: units.check_units(place.units)),
        ("devices", lambda: _check_devices(place)),
        ("devices", devices.check_drivers),
        ("router", lambda: _check_uplinks(config)),
    ]
    return [finding for about, check in checks for finding in looked_at(about, check)]


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def _check_memory(host: Host) -> list[Finding]:
    memory = computer_facts.read_memory(host)
    return [note("memory", "unknown here.")] if memory is None else computer.check_memory(memory)


def _check_role(place: Place) -> list[Finding]:
    """Whether robot.toml is a robot's where services of a robot are to run."""
    if place.host_config is None or place.config is not None:
        return []
    wanted = [unit.name for unit in place.units or [] if unit.is_wanted and unit.needs_robot]
    return settings.check_without_robot(place.config_path, wanted)


def _check_kept(place: Place) -> list[Finding]:
    if place.config is None or place.config_path is None:
        return []
    return [
        *settings.check_kept(place.config_path, place.state),
        *settings.check_name(place.config.robot.name, place.state),
    ]


def _check_devices(place: Place) -> list[Finding]:
    if place.config is None:
        return []
    return devices.check_ports(devices.read_ports(place.config, place.user))


def _check_uplinks(config: HostConfig | None) -> list[Finding]:
    if config is None:
        return []
    try:
        keys = find_keys(certificates.keys_folder(config))
    except KeysError:  # a check of its own says why
        keys = None
    return [one for uplink in config.zenoh.uplink for one in endpoints.check_uplink(uplink, keys)]


def _check_rights(place: Place) -> list[Finding]:
    key = certificates.keys_folder(place.host_config) / KEY
    access = rights.read_access(place.user, place.config_path, place.state, key)
    found = rights.check_access(access)
    secrets = [key]
    if place.robot_state is not None:
        secrets.append(place.robot_state / "viewer_access.toml")
    if place.host_config is not None:
        secrets += rights.named_secrets(place.host_config)
    return found + rights.check_secrets(secrets, place.user)


def _check_map(place: Place) -> list[Finding]:
    config, state = place.config, place.robot_state
    if config is None or state is None:
        return []
    named = config.map.file
    file = settings.chosen_map(
        state, place.state / "maps", None if named is None else config.path(named)
    )
    kept_aside = settings.check_kept_aside(state)
    if file is None:
        if config.planner.frame == "odom":
            return kept_aside
        text = "No map is set, so the robot cannot drive anywhere."
        remedy = (
            "Make one (`trolley map new NAME`), name one in [map] file, or set [planner] "
            'frame = "odom" to drive without.'
        )
        return [*kept_aside, problem("map", text, remedy)]
    grid = settings.read_map(file)
    if isinstance(grid, Finding):
        return [*kept_aside, grid]
    found = settings.check_map(settings.facts_of(grid))
    return [*found, *_check_saved(state, grid, file), *kept_aside]


def _check_saved(state: Path, grid: GridMap, file: Path) -> list[Finding]:
    poses = settings.read_list(state / "poses.toml", settings.PlaceFile, "poses")
    stored = state / "zones" / f"{grid.name}.toml"
    seeds = file.with_name(f"{file.stem}.zones.toml")
    zones = settings.read_list(stored if stored.exists() else seeds, ZoneFile, "zones")
    return [
        *([poses] if isinstance(poses, Finding) else settings.check_places(grid, poses)),
        *([zones] if isinstance(zones, Finding) else settings.check_zones(grid, zones)),
    ]


@contextmanager
def trying(place: Place) -> Generator[trial.Running]:
    """A trial of the services, which runs while other things are looked at."""
    is_other = place.user.uid != os.geteuid()
    may_change = os.geteuid() == 0
    environment = {"TROLLEY_STATE": str(place.state)}
    if may_change or not is_other:  # what they keep is not for others to make
        for unit in place.units or []:
            if CACHE_VARIABLE in unit.environment:
                environment[CACHE_VARIABLE] = unit.environment[CACHE_VARIABLE]
    user = place.user if is_other and may_change else None
    if user is not None:
        environment["HOME"] = str(UNIT_STATE)
    running = trial.Running(None if place.config is None else place.config_path, environment, user)
    try:
        yield running
    finally:
        running.end()


def examine_robots(
    place: Place, target: Target, seconds: float, *, is_wanted: bool
) -> list[tuple[str, list[Finding]]]:
    """All checks of the robots that run, by their names; "" for what is about the router.

    Args:
        place: this host.
        target: which robot, through which router; all that are there where it names none.
        seconds: how long to listen.
        is_wanted: whether somebody said that a robot should be there.
    """
    where = target.endpoints
    is_needed = is_wanted or any(unit.is_wanted for unit in place.units or [])
    try:
        with Connection(where, keys=target.keys) as connection:
            knocked = [endpoints.knock(one) for one in where] if len(where) > 1 else []
            silent = tuple(one for one in knocked if one is not None and one.trouble)
            door = endpoints.Door(where, "", _owner_of(where), silent)
            found = [("", endpoints.check_door(door))]
            wanted, there = target.robot, connection.robots()
            if wanted is not None and wanted not in (*there, _own_robot(place)):
                text = f"There is no robot called {wanted} at {', '.join(where)}."
                text += f" {did_you_mean(wanted, there)}"
                return [*found, (wanted, [problem("robot", text, "Check --robot.")])]
            names = there if wanted is None else [wanted]
            if not names:
                text = "The router is there, but no robot."
                found.append(("", [note("router", text, "`trolley up` starts one.")]))
            needs_map = place.host_config is None or place.host_config.planner.frame == "map"
            listening = partial(listen, needs_map=needs_map, with_mqtt=place.bridged_robot)
            heard = listening(connection, names, seconds) if names else []
            checked = [(one.name, looked_at("robot", partial(check_robot, one))) for one in heard]
            return [*found, *checked]
    except RouterBusy as error:
        text = str(error).partition(". ")[0]
        remedy = "`trolley top` shows who sends how much, `top` what keeps this computer busy."
        return [("", [problem("router", f"{text[0].upper()}{text[1:]}.", remedy)])]
    except RobotUnreachable as error:
        door = endpoints.Door(where, str(error), _owner_of(where), is_wanted=is_needed)
        return [("", endpoints.check_door(door))]


def _own_robot(place: Place) -> str | None:
    return None if place.config is None else place.config.robot.name


def _owner_of(where: Sequence[str]) -> str:
    """Who listens at the ports of this host among these endpoints."""
    local = [port for port in map(ports.port_of, where) if port is not None]
    return next(filter(None, map(ports.owner, local)), "")
