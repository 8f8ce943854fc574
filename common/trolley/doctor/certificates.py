"""Checks of this host's certificate and those it trusts."""

import dataclasses
import os
import ssl
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from trolley.config import HostConfig, RobotConfig
from trolley.doctor.finding import Finding, note, ok, problem, warning
from trolley.files import read_file
from trolley.security.host_keys import (
    AUTHORITY,
    CERTIFICATE,
    DEFAULT_FOLDER,
    KEY,
    KeysError,
    find_keys,
)

SOON_DAYS = 30.0
AUTHORITY_ROLE = "ca"


@dataclasses.dataclass(frozen=True)
class Validity:
    """From when till when a certificate is good."""

    role: str
    name: str
    path: str
    not_before: datetime
    not_after: datetime


def keys_folder(config: HostConfig | None) -> Path:
    """Where this host's certificate lies."""
    return DEFAULT_FOLDER if config is None else config.path(config.zenoh.keys)


def needs_keys(config: HostConfig | None) -> bool:
    """Whether any connection of the configuration is over TLS."""
    if config is None:
        return False
    return any(one.startswith("tls/") for one in (*config.zenoh.connect, *config.zenoh.uplink))


def read_validities(folder: Path) -> list[Validity] | Finding:
    """The certificates of a folder, or why they cannot be read."""
    # Not at the top: few hosts have certificates, and their library takes memory and time.
    from trolley.security.certificates import read_certificates

    try:
        found = read_certificates(folder)
    except KeysError as error:
        return problem("certificates", f"{error}.", "`trolley keys` makes new ones.")
    return [
        Validity(one.role, one.name, str(one.path), one.not_before, one.not_after) for one in found
    ]


def check_certificates(found: list[Validity], now: datetime) -> list[Finding]:
    """Whether certificates are good today and for some time."""
    findings: list[Finding] = []
    for one in found:
        who = f"The certificate {one.role} {one.name} ({one.path})"
        option = "--name " if one.role == "router" else ""
        new = (
            f"`trolley keys {one.role} {option}{one.name} --replace` on the computer with the "
            "authority, then copy its files here."
        )
        if one.role == AUTHORITY_ROLE:
            new = "Make a new authority, and with it all certificates (docs/network.md)."
        days = (one.not_after - now).total_seconds() / 86_400.0
        if now < one.not_before:
            findings.append(
                problem(
                    "certificates",
                    f"{who} is valid from {one.not_before:%Y-%m-%d} on, but here it is "
                    f"{now:%Y-%m-%d}.",
                    "Set the clock of this computer.",
                )
            )
        elif days < 0.0:
            findings.append(
                problem(
                    "certificates",
                    f"{who} expired on {one.not_after:%Y-%m-%d}, and here it is {now:%Y-%m-%d}.",
                    f"If that is wrong, set the clock of this computer. Else: {new}",
                )
            )
        elif days < SOON_DAYS:
            findings.append(warning("certificates", f"{who} expires in {days:.0f} days.", new))
        else:
            findings.append(ok("certificates", f"{who} is valid until {one.not_after:%Y-%m-%d}."))
    return findings


def check_keys(config: HostConfig | None, now: datetime) -> list[Finding]:
    """Whether the certificates that the configuration needs are there and good."""
    folder = keys_folder(config)
    if not folder.exists():
        if needs_keys(config):
            return [
                problem(
                    "certificates",
                    f"robot.toml connects over TLS, but there is no folder {folder}.",
                    "Make certificates with `trolley keys` (docs/network.md).",
                )
            ]
        return [ok("certificates", "None are set up here, and none are needed.")]
    if not os.access(folder, os.R_OK | os.X_OK):  # else it would look empty
        return [note("certificates", f"You may not read {folder}.", "Run this again with `sudo`.")]
    found = read_validities(folder)
    if isinstance(found, Finding):
        return [found]
    return [
        *check_certificates(found, now),
        *_check_name(found, folder, config),
        *_check_pair(folder),
    ]


def _check_name(found: list[Validity], folder: Path, config: HostConfig | None) -> list[Finding]:
    """Whether a robot's certificate is of the robot that robot.toml names."""
    own = next((one for one in found if one.path == str(folder / CERTIFICATE)), None)
    if own is None or own.role != "robot" or not isinstance(config, RobotConfig):
        return []
    name = config.robot.name
    if own.name == name:
        return []
    return [
        problem(
            "certificates",
            f"The certificate {own.path} is of robot {own.name}, but [robot] name is {name}: "
            "other hosts hear nothing of it.",
            f"`trolley keys robot {name}` on the computer with the authority, then copy its files "
            "here.",
        )
    ]


def _check_pair(folder: Path) -> list[Finding]:
    """Whether this host's certificate, private key and authority are there and belong together."""
    from trolley.security.certificates import is_issued_by  # not at the top: see above

    files = f"{AUTHORITY}, {CERTIFICATE} and {KEY}"
    text = f"{files} in {folder} do not belong together, or one of them is broken."
    try:
        find_keys(folder)
        with suppress(ssl.SSLError):
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            context.load_cert_chain(folder / CERTIFICATE, folder / KEY)
            if is_issued_by(read_file(folder / CERTIFICATE), read_file(folder / AUTHORITY)):
                return []
    except KeysError as error:
        if isinstance(error.__cause__, PermissionError):
            return [note("certificates", f"{error}.", "Run this again with `sudo`.")]
        text = f"{error}."
    remedy = "Copy the files that `trolley keys` made for this host again."
    return [problem("certificates", text, remedy)]
