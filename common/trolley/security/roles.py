"""What each role may do: rules for Zenoh's access control, made from a list of certificates.

What a role may not do is refused where it enters a router; what another host sent by right may go
to everyone who was let in. A rule allows only what it includes wholly: `trolley/**` allows
subscribing to `trolley/*/pose`, and `**` never includes a chunk that begins with `@`.

There are no rules that deny: Zenoh applies one only to keys that it includes wholly, so one for
`tf/odom` would let a put to `tf/*` pass. What is allowed is listed instead (`all_but`).
"""

import dataclasses
import string
from collections.abc import Iterable
from typing import Any

from trolley import requests, topics
from trolley.security.certificates import Certificate, as_role
from trolley.topics import ROOT, Kind

Rule = dict[str, Any]

STREAMS, REQUESTS = f"{ROOT}/**", f"{ROOT}/*/@do/**"
ANYTHING = ("**", REQUESTS)
ROS_NODES = ("@ros2_lv/**", "**/@adv/**")
"""What nodes of ROS 2 show of themselves, and ask each other for what was published before."""
READING = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
WRITING = ("put", "delete")
OWNING = (*WRITING, "declare_queryable", "reply", "liveliness_token")
EVERYTHING = (*READING, *OWNING)
VIEWER_SERVICE = "viz-$*"
ALPHABET = f"{string.ascii_letters}{string.digits}_-.:"
"""What may stand where the name of an operator's frame begins to differ from those of the robot."""


@dataclasses.dataclass(frozen=True)
class Grant:
    """Messages that may enter with these keys."""

    messages: tuple[str, ...]
    keys: tuple[str, ...]


def all_but(names: Iterable[str]) -> list[str]:
    """Expressions for a chunk that include all names but these, and no pattern that means one.

    Each goes along with one of the names for a while and then differs from all of them: for `ab`
    these are `b$*`, `c$*`, …, `a`, `aa$*`, `ac$*`, …, `aba$*`, `abb$*`, …
    """
    forbidden = set(names)
    beginnings = {name[:length] for name in forbidden for length in range(len(name) + 1)}
    found = sorted(beginnings - forbidden - {""})
    for beginning in sorted(beginnings):
        others = (f"{beginning}{letter}" for letter in ALPHABET)
        found += [f"{other}$*" for other in others if other not in beginnings]
    return found


def grants(role: str, name: str) -> list[Grant]:
    """What a certificate of this role and name may do.

    Raises:
        KeysError: There is no such role.
    """
    match as_role(role):
        case "viewer":
            return _viewer()
        case "operator":
            return _operator()
        case "robot":
            own = (f"{ROOT}/{name}/**", f"{ROOT}/{name}/@do/**")
            return [Grant(READING, (STREAMS,)), Grant(EVERYTHING, own)]
        case "router":  # it has checked its own clients already
            return [Grant(EVERYTHING, (STREAMS, REQUESTS))]


def access_control(certificates: Iterable[Certificate]) -> dict[str, Any]:
    """Zenoh's `access_control` for a router that lets these certificates in over TLS.

    Programs of the router's own host, which come over loopback without TLS or over a Unix socket
    that they may open, may do everything.
    """
    rules: list[Rule] = [
        _rule("out", "egress", Grant(EVERYTHING, ANYTHING)),
        _rule("local-in", "ingress", Grant(EVERYTHING, (*ANYTHING, *ROS_NODES))),
        _rule("local-out", "egress", Grant(EVERYTHING, ROS_NODES)),
    ]
    subjects: list[Rule] = [
        {"id": "local", "interfaces": ["lo"], "link_protocols": ["tcp"]},
        {"id": "socket", "link_protocols": ["unixsock-stream"]},
    ]
    policies: list[Rule] = [
        {"rules": ["local-in", "out", "local-out"], "subjects": ["local", "socket"]}
    ]
    for certificate in certificates:
        who = certificate.common_name
        made = [
            _rule(f"{who}-{i}", "ingress", grant)
            for i, grant in enumerate(grants(certificate.role, certificate.name))
        ]
        rules += made
        subjects.append({"id": who, "cert_common_names": [who]})
        policies.append({"rules": [*(rule["id"] for rule in made), "out"], "subjects": [who]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _viewer() -> list[Grant]:
    own = (
        topics.CHOICE.key("*", "*"),
        topics.HEALTH.key("*", VIEWER_SERVICE),
        topics.ALIVE.key("*", VIEWER_SERVICE, "*"),
    )
    return [
        Grant(READING, (STREAMS,)),
        Grant(("query",), (requests.BASE_STOP.key("*"),)),
        Grant(OWNING, own),
    ]


def _operator() -> list[Grant]:
    # The stream `poses` itself is not among them, as it were in `poses/**`.
    stored = [topic.key("*") for topic in topics.TOPICS if topic.kind is Kind.STORED]
    cleared = [f"{ROOT}/*/{topic.chunks[0]}/**" for topic in topics.TOPICS if topic.is_drawing]
    frames = all_but(child for (child,) in topics.TF.owned_parts)
    driven = [
        topics.COMMAND.key("*", "teleop"),
        topics.COMMAND.key("*", "ros2"),
        topics.COSTS.key("*", "*"),
        *(topics.TF.key("*", one) for one in frames),
    ]
    return [
        *_viewer(),
        Grant(("query",), (REQUESTS,)),
        Grant(WRITING, (*stored, *cleared, *driven)),
    ]


def _rule(name: str, flow: str, grant: Grant) -> Rule:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(grant.messages),
        "key_exprs": list(grant.keys),
    }
