"""`trolley keys`: certificates for the hosts that talk over TLS."""

import functools
import socket
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import ParamSpec, TypeVar

import click

from trolley.cli import SuggestingGroup
from trolley.cli.options import json_option
from trolley.cli.printing import say, say_block
from trolley.cli.show import print_json
from trolley.doctor.computer import FIRST_YEAR
from trolley.files import expand_home
from trolley.ports import ROUTER_TLS_PORT
from trolley.security.certificates import (
    ROLES,
    VALID_DAYS,
    Certificate,
    Role,
    as_role,
    read_certificates,
)
from trolley.security.host_keys import ALLOWED, DEFAULT_FOLDER, HostKeys, KeysError
from trolley.security.keyring import Keyring

P = ParamSpec("P")
R = TypeVar("R")

RENEW_DAYS = 90
ROUTER_NAME = "home"


def _reports(command: Callable[P, R]) -> Callable[P, R]:
    """Turn a KeysError into one line on stderr and exit code 2."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except KeysError as error:
            raise click.UsageError(str(error)) from error

    return run


@click.group(
    name="keys",
    cls=SuggestingGroup,
    sections={
        "Make": ("init", "router", "robot", "operator", "viewer"),
        "Keep": ("list", "remove"),
    },
)
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("~/trolley-keys"),
    show_default=True,
    help="Where all keys are kept; whoever can read it can do anything.",
)
@click.pass_context
def keys_command(context: click.Context, folder: Path) -> None:
    """Make certificates for the hosts that may talk to your robots.

    Each host has one certificate, and each certificate one role. Keep the folder in a safe place.
    """
    context.obj = Keyring(expand_home(folder))


_replace = click.option("--replace", is_flag=True, help="Make new keys; the old ones stop working.")
_days = click.option(
    "--days",
    type=click.IntRange(1, 20 * 365),
    default=VALID_DAYS,
    show_default=True,
    help="How long the certificate is valid.",
)


@keys_command.command(name="init")
@json_option
@click.pass_obj
@_reports
def init(keyring: Keyring, as_json: bool) -> None:
    """Make the authority that signs all certificates (once)."""
    keyring.create(_plausible_now())
    if as_json:
        print_json(_made(keyring.folder, keyring.authority()))
        return
    say_block(
        f"Made {keyring.folder}. Keep it safe and keep a copy: without it no certificate can be "
        "made or renewed.\nNext: `trolley keys router`, for the host that all others connect to."
    )


@keys_command.command(name="router")
@click.argument("hosts", nargs=-1, metavar="[HOST]...")
@click.option("--name", default=ROUTER_NAME, show_default=True, help="The router's name.")
@_days
@_replace
@json_option
@click.pass_obj
@_reports
def router(
    keyring: Keyring, hosts: tuple[str, ...], name: str, days: int, replace: bool, as_json: bool
) -> None:
    """Make keys for a router that other hosts connect to.

    HOST is each name and address at which others reach it [default: with --replace those of the
    old keys, else this host's name].
    """
    own = socket.gethostname()
    routers = [one for one in keyring.certificates() if one.role == "router"]
    before = [one.hosts for one in routers if one.name == name]
    reached = hosts or (before[0] if before else (own, f"{own}.local"))
    keys = keyring.issue("router", name, _until(keyring, days), reached, replace=replace)
    if as_json:
        print_json(_made(keys.folder, _certificate(keys)))
        return
    _say_made(keys)
    say_block(
        f"Others reach it at {', '.join(reached)}, port {ROUTER_TLS_PORT}. Copy the files to that "
        f"host:\n{_copying(keys)}\nThen restart its router; its robot.toml needs no change."
    )


def _add_client_command(role: Role, text: str) -> None:
    """Add the command that makes keys for a host of a role."""

    @keys_command.command(name=role, help=text)
    @click.argument("name")
    @_days
    @_replace
    @json_option
    @click.pass_obj
    @_reports
    def issue(keyring: Keyring, name: str, days: int, replace: bool, as_json: bool) -> None:
        keys = keyring.issue(role, name, _until(keyring, days), replace=replace)
        if as_json:
            print_json(_made(keys.folder, _certificate(keys)))
            return
        routers = [one for one in keyring.certificates() if one.role == "router"]
        host = routers[0].hosts[0] if routers and routers[0].hosts else "HOST"
        _say_made(keys)
        say_block(
            f"Copy the folder's files to that host:\n{_copying(keys)}\n"
            f'Add to its robot.toml:\n  [zenoh]\n  uplink = ["tls/{host}:{ROUTER_TLS_PORT}"]'
        )
        _say_routers(routers)


_add_client_command(
    "robot", "Make keys for the robot NAME, which is `[robot] name` in its robot.toml."
)
_add_client_command("operator", "Make keys for a host that may watch and command all robots.")
_add_client_command("viewer", "Make keys for a host that may watch all robots, and stop them.")


@keys_command.command(name="remove")
@click.argument("role", metavar="ROLE", type=click.Choice(ROLES))
@click.argument("name")
@json_option
@click.pass_obj
@_reports
def remove(keyring: Keyring, role: str, name: str, as_json: bool) -> None:
    """Revoke a host, such as one that was lost."""
    keyring.remove(as_role(role), name)
    routers = [one for one in keyring.certificates() if one.role == "router"]
    if as_json:
        print_json({"role": role, "name": name, "routers": [one.name for one in routers]})
        return
    say(f"Removed {role} {name}.")
    _say_routers(routers)


@keys_command.command(name="list")
@click.argument("host_folder", required=False, type=click.Path(exists=True, path_type=Path))
@json_option
@click.pass_obj
@_reports
def list_keys(keyring: Keyring, host_folder: Path | None, as_json: bool) -> None:
    """List all certificates with role, name and last day.

    With HOST_FOLDER (such as /etc/trolley/keys) list those on a host.
    """
    if host_folder is not None:
        found = read_certificates(host_folder)
    else:
        found = [keyring.authority(), *keyring.certificates()]
    if as_json:
        print_json([_plain(one) for one in found])
        return
    for one in found:
        say(_line(one, _now()))


def _plain(one: Certificate) -> dict[str, object]:
    until = one.not_after.isoformat()
    return {"role": one.role, "name": one.name, "until": until, "hosts": list(one.hosts)}


def _line(one: Certificate, now: datetime) -> str:
    days = one.days_left(now)
    state = ""
    if days <= 0:
        state = "EXPIRED"
    elif days < RENEW_DAYS:
        state = f"renew it: {days:.0f} days left"
    return f"{one.role:<9} {one.name:<20} until {one.not_after:%Y-%m-%d}  {state}".rstrip()


def _made(folder: Path, certificate: Certificate) -> dict[str, object]:
    return {"folder": str(folder), **_plain(certificate)}


def _certificate(keys: HostKeys) -> Certificate:
    return next(one for one in read_certificates(keys.folder) if one.path == keys.certificate)


def _say_made(keys: HostKeys) -> None:
    say(f"Made {keys.folder}, valid until {_certificate(keys).not_after:%Y-%m-%d}.")


def _copying(keys: HostKeys) -> str:
    return (
        f"  {keys.folder}/* -> {DEFAULT_FOLDER}/ (or the folder `keys` beside its robot.toml),\n"
        "  readable by the user that runs Trolley: sudo chown -R trolley: /etc/trolley/keys"
    )


def _say_routers(routers: list[Certificate]) -> None:
    if not routers:
        say("No router accepts it yet: run `trolley keys router`.")
    for one in routers:
        say(
            f"Copy {one.path.parent / ALLOWED} to the router {one.name} again, into its keys "
            "folder, and restart it: sudo systemctl restart trolley-router"
        )


def _until(keyring: Keyring, days: int) -> datetime:
    """Until when a new certificate is valid."""
    now, authority = _plausible_now(), keyring.authority()
    if authority.days_left(now) <= 0.0:
        raise KeysError(
            f"the authority in {keyring.folder} expired on {authority.not_after:%Y-%m-%d}, and "
            f"here it is {now:%Y-%m-%d}: if that is right, make a new one, and with it all "
            "certificates, in another --folder"
        )
    return now + timedelta(days=days)


def _plausible_now() -> datetime:
    """The time, which a computer without a clock may not know."""
    now = _now()
    if now.year < FIRST_YEAR:
        raise KeysError(
            f"the clock of this computer says that it is {now:%Y-%m-%d}, so certificates would "
            "expire too soon: connect it to the internet, or set the time with `sudo date -s "
            "'2026-05-01 12:00'`"
        )
    return now


def _now() -> datetime:
    return datetime.now(UTC)
