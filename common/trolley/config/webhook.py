"""`[webhook]`: web addresses that are told what has happened."""

import re
import urllib.parse
from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.network_ports import names_a_host

MAX_URLS = 10
MAX_URL = 2000
_CHARACTERS = re.compile(r"[\x21-\x7e]+")

EventType = Literal[
    "arrived",
    "failed",
    "stuck",
    "tour_done",
    "tour_failed",
    "waiting",
    "stopped",
    "lost",
    "fault",
    "battery_low",
    "located",
]
"""What can happen: `trolley_mqtt.events` says when."""


class WebhookConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Web addresses that are sent a POST with JSON when something has happened."""

    urls: Annotated[list[str], Meta(max_length=MAX_URLS)] = []
    """Where to send the events, such as `https://house.example/robot`; empty for nowhere."""
    events: list[EventType] = []
    """What to send; everything if empty."""
    token_file: str = ""
    """A file whose first line is sent as `Authorization: Bearer …`, relative to this file."""
    tls_ca: str = ""
    """Trust only the certificate authority in this PEM file; else those this computer trusts."""

    def __post_init__(self) -> None:
        """Refuse what is no web address."""
        for index, url in enumerate(self.urls):
            problem = _problem_of(url)
            if problem:
                raise ValueError(f"urls[{index}] {problem}")


def _problem_of(url: str) -> str:
    """What is wrong with a URL, without a word of it: it may hold a secret."""
    example = "write one such as https://house.example/robot"
    if len(url) > MAX_URL or not _CHARACTERS.fullmatch(url):
        return f"is not a web address: {example}"
    try:
        parts = urllib.parse.urlsplit(url)
        port = parts.port
    except ValueError:
        return f"is not a web address: {example}"
    is_web = parts.scheme in ("http", "https")
    if not is_web or port == 0 or not names_a_host(parts.hostname or ""):
        return f"is not a web address: {example}"
    if parts.username is not None:
        return "has a user name or password in it: use `token_file`"
    return ""
