"""Strangers at the port for other hosts: local programs and lawful hosts must not wait for them."""

import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from bench.faults.cases import BACK_WITHIN_S, Outcome
from bench.faults.robot import ROBOT, Missing, Rig, describe
from bench.faults.saved import lost

from trolley import requests
from trolley.connection import Connection, RobotUnreachable
from trolley.messages.request_params import AskHistory
from trolley.security.host_keys import HostKeys
from trolley.security.keyring import Keyring

CLIENT = Path(__file__).parent / "door_client.py"
MANY = 2000
HANGS_S = 15.0
# As required of a robot at whose door 2,000 connections hang.
LOCAL_WITHIN_S, FAR_WITHIN_S, BACK_TO_NORMAL_S = 0.2, 5.0, 5.0
USUAL_LINK_S = 1.0
# How often it is asked before anybody comes.
NUM_BEFORE = 25
HOWS = {
    "silent": "that say nothing",
    "half": "that say half a TLS hello",
    "hello": "that say a TLS hello and no more",
    "drip": "that say a byte a second",
    "rubbish": "that speak no TLS",
}
SAME, OTHERS = ["127.0.0.1"], [f"127.0.0.{number}" for number in range(2, 6)]


class Crowd(NamedTuple):
    """Where strangers come from, and whether they come again whenever sent away."""

    addresses: list[str]
    again: str
    words: str


ONCE = Crowd(SAME, "once", "from its own address")
OFTEN = Crowd(OTHERS, "again", "from four others, coming again whenever sent away")
OWN_OFTEN = Crowd(SAME, "again", "from its own address, coming again whenever sent away")
# Only a crowd that greets as a lawful host does cannot be told from one at its own address.
CROWDS = {how: (ONCE, OFTEN, OWN_OFTEN) if how == "hello" else (ONCE, OFTEN) for how in HOWS}


def strangers(named: str = "") -> list[Outcome]:
    """Hang at the door in all ways, from a legitimate host's own address and from four others.

    Args:
        named: only in those ways whose name contains this.
    """
    outcomes: list[Outcome] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ring, now = Keyring(folder / "ring"), datetime.now(UTC)
        ring.create(now)
        until = now + timedelta(days=1)
        keys = ring.issue("router", "home", until, ["127.0.0.1"], replace=False)
        person = ring.issue("operator", "anna", until, replace=False)
        port = _free_port()
        words = ["--listen", f"tls/0.0.0.0:{port}", "--keys", str(keys.folder)]
        rig = stack.enter_context(Rig(folder / "rig", router=words))
        rig.prepare()
        for how, words in HOWS.items():
            for crowd in CROWDS[how]:
                outcome = Outcome(f"{MANY} connections {words}, {crowd.words}", "")
                if named not in outcome.fault:
                    continue
                try:
                    _hang(rig, outcome, port, person, how, crowd)
                except Missing as missing:
                    outcome.wrong.append(f"{missing} ({describe(rig)})")
                print(" | ".join(outcome.cells), flush=True)
                outcomes.append(outcome)
    return outcomes


def _hang(rig: Rig, outcome: Outcome, port: int, person: HostKeys, how: str, crowd: Crowd) -> None:
    rig.wait_for_driving(BACK_WITHIN_S)
    before, collisions = rig.saved(), rig.collisions
    ordinary_s = [_seconds(ask) for _ in range(NUM_BEFORE) for ask in _asking(rig)]
    command = [sys.executable, str(CLIENT), str(port), how, crowd.again, str(MANY), str(HANGS_S)]
    command = ["nice", "-n", "10", *command, *crowd.addresses]  # it stands for other hosts
    far = f"tls/127.0.0.1:{port}"
    local_s: list[float] = []
    far_s: list[float] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE) as there:
        assert there.stdout is not None
        there.stdout.readline()
        while there.poll() is None:
            local_s += [_seconds(ask) for ask in _asking(rig)]
            far_s.append(_seconds(lambda: _ask(far, person)))
            time.sleep(0.3)
    ended_s = time.monotonic()
    normal_s = None
    while normal_s is None and time.monotonic() < ended_s + BACK_TO_NORMAL_S:
        if _seconds(lambda: _ask(far, person)) < USUAL_LINK_S:
            normal_s = time.monotonic() - ended_s
    rig.wait_for_driving(BACK_WITHIN_S)
    outcome.happened = (
        f"local requests and new sessions: 95% within {_most(local_s):.2f} s, all within "
        f"{max(local_s):.2f} s (before: {_most(ordinary_s):.2f} and {max(ordinary_s):.2f} s); a "
        f"link with a certificate within {max(far_s):.1f} s"
    )
    if _most(local_s) > LOCAL_WITHIN_S:
        outcome.wrong.append(f"{_most(local_s):.2f} s for local requests")
    if max(far_s) > FAR_WITHIN_S:
        outcome.wrong.append(f"{max(far_s):.1f} s for a lawful link")
    if normal_s is None:
        outcome.wrong.append(f"not as before {BACK_TO_NORMAL_S:.0f} s later")
    outcome.lost = lost(before, rig.saved())
    if rig.collisions > collisions:
        outcome.wrong.append(f"{rig.collisions - collisions} collisions")


def _asking(rig: Rig) -> tuple[Callable[[], object], ...]:
    """Ask by a new local session, and by one that is open."""
    return (
        lambda: _ask(rig.endpoint, None),
        lambda: rig.ask(requests.TOUR_HISTORY, AskHistory()),
    )


def _ask(endpoint: str, keys: HostKeys | None) -> None:
    """Ask the robot something over a session of one's own."""
    try:
        with Connection([endpoint], 30.0, keys) as connection:
            connection.ask(ROBOT, requests.TOUR_HISTORY, AskHistory())
    except RobotUnreachable as problem:
        raise Missing(f"{endpoint}: {problem}") from problem


def _most(times_s: list[float]) -> float:
    """What 95% of them do not exceed: the crowd shares the processors of this machine."""
    return sorted(times_s)[int(0.95 * (len(times_s) - 1))]


def _seconds(act: Callable[[], object]) -> float:
    began_s = time.monotonic()
    act()
    return time.monotonic() - began_s


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
