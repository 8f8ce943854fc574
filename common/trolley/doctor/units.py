"""Checks of the systemd units: which run, which have failed, which keep being restarted."""

import dataclasses
from collections.abc import Mapping

from trolley.doctor.computer_facts import Host
from trolley.doctor.finding import Finding, note, ok, problem, warning

PATTERN = "trolley-*.service"
FOLDERS = ("etc/systemd/system", "usr/lib/systemd/system", "lib/systemd/system")
OFTEN = 3
"""From so many restarts on something is wrong with a service."""
CANNOT_USE_CONFIG = "2"
ROUTER = "router"
"""The service that needs no robot.toml."""
_PROPERTIES = (
    "Id,LoadState,ActiveState,SubState,UnitFileState,NRestarts,Result,ExecMainStatus,User,"
    "SupplementaryGroups,Environment"
)


@dataclasses.dataclass(frozen=True)
class Unit:
    """A unit as `systemctl show` describes it."""

    name: str
    active: str
    """`active`, `activating`, `failed`, `inactive`, ..."""
    enabled: str = ""
    sub: str = ""
    """`running`, `auto-restart`, ..."""
    restarts: int = 0
    result: str = "success"
    exit_status: str = "0"
    user: str = ""
    groups: tuple[str, ...] = ()
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict[str, str])

    @property
    def service(self) -> str:
        """The service's name, such as `base`."""
        return self.name.removeprefix("trolley-").partition(".")[0]

    @property
    def is_wanted(self) -> bool:
        """Whether it is started with the system."""
        return self.enabled == "enabled"

    @property
    def needs_robot(self) -> bool:
        """Whether it runs with a robot's robot.toml: all do but the router."""
        return self.service != ROUTER


def read_units(host: Host) -> list[Unit] | None:
    """Trolley's services; None where systemd does not run."""
    if not (host.root / "run/systemd/system").exists():
        return None
    # By their files: systemd itself has forgotten those that have not run since the start.
    files = [path for folder in FOLDERS for path in host.find(f"{folder}/{PATTERN}")]
    names = sorted({path.name for path in files if "@" not in path.name})
    if not names:
        return []
    said = host.run(["systemctl", "show", f"--property={_PROPERTIES}", *names])
    return [] if said is None else parse_units(said)


def parse_units(text: str) -> list[Unit]:
    """Read what `systemctl show` prints: `Name=value` lines, units apart by an empty one."""
    found: list[Unit] = []
    for block in text.split("\n\n"):
        pairs = (line.partition("=") for line in block.splitlines())
        says = {name: value for name, equals, value in pairs if equals}
        if "Id" not in says or says.get("LoadState") == "not-found":
            continue
        restarts = says.get("NRestarts", "0")
        found.append(
            Unit(
                name=says["Id"],
                active=says.get("ActiveState", ""),
                sub=says.get("SubState", ""),
                enabled=says.get("UnitFileState", ""),
                restarts=int(restarts) if restarts.isdigit() else 0,
                result=says.get("Result", ""),
                exit_status=says.get("ExecMainStatus", "0"),
                user=says.get("User", ""),
                groups=tuple(says.get("SupplementaryGroups", "").split()),
                environment={
                    name: value
                    for name, equals, value in (
                        word.partition("=") for word in says.get("Environment", "").split()
                    )
                    if equals
                },
            )
        )
    return sorted(found, key=lambda unit: unit.name)


def check_units(units: list[Unit] | None) -> list[Finding]:
    """Whether the services that this host should run do run."""
    if units is None:
        return [ok("services", "systemd is not running here, so nothing starts by itself.")]
    if not units:
        return [ok("services", "No services of Trolley are installed on this computer.")]
    return [_check_unit(unit) for unit in units]


def _check_unit(unit: Unit) -> Finding:
    log = f"`journalctl -u {unit.name} -n 50` says why"
    again = f"`sudo systemctl restart {unit.name}` after that."
    if unit.active == "failed":
        if unit.exit_status == CANNOT_USE_CONFIG:
            return problem(
                "services",
                f"{unit.name} has stopped because it cannot use robot.toml.",
                f"{log}; correct the file. {again}",
            )
        return problem("services", f"{unit.name} has failed ({unit.result}).", f"{log}; {again}")
    if unit.restarts > OFTEN:
        return warning(
            "services", f"{unit.name} has been restarted {unit.restarts} times.", f"{log}."
        )
    if unit.sub == "auto-restart":
        return problem(
            "services", f"{unit.name} stops every time it is started.", f"{log}; {{again}}"
        )
    if unit.active == "activating":
        return warning("services", f"{unit.name} is not ready yet.", f"Wait a little; {log}.")
    if unit.active != "active":
        if unit.is_wanted:
            return problem(
                "services",
                f"{unit.name} should be running, but is not.",
                f"`sudo systemctl start {unit.name}`; {log}.",
            )
        return ok("services", f"{unit.name} is not in use.")
    if unit.restarts:
        return note("services", f"{unit.name} is running; it was restarted {unit.restarts} times.")
    return ok("services", f"{unit.name} runs.")
