"""Floods, and messages that nobody may understand, on every key and request there is."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from bench.faults.cases import BACK_WITHIN_S, COMMAND_LOST_S, GRAIN_S, Outcome
from bench.faults.payloads import HUGE_BYTES, Target, broken, targets, valid
from bench.faults.robot import ROBOT, STANDS_MPS, Missing, Rig, describe
from bench.faults.saved import Saved, lost

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.connection import RobotUnreachable
from trolley.messages import ErrorReply
from trolley.messages.request_params import LoadMap
from trolley.runtime import codec
from trolley.runtime.bus import Reply
from trolley.topics import Qos

CLIENT = Path(__file__).parent / "flood_client.py"
RATE = 10_000
FLOOD_S = 3.0
# A stop is answered within this time whatever else is going on [s].
ANSWERED_WITHIN_S = 1.0
PATIENCE_S = 30.0
# The ones that a flood could hurt most: while the robot drives, by four clients at once.
DRIVING_KEYS = (
    "cmd_vel/planner",
    "scan",
    "odom",
    "map",
    "goal",
    "@do/base/resume",
    "@do/goal/preview",
    "@do/poses/put",
)
MAP = "apartment"
HEARD_S = 4.0
"""Longer than anybody may wait for an answer about what was heard."""
NUM_PLAYED = 60
REFUSALS = (codes.BAD_REQUEST, codes.TOO_LARGE, codes.UNKNOWN_NAME)


class Flood:
    """Clients that send all they can; a context manager."""

    def __init__(self, rig: Rig, target: Target, num_clients: int, seconds: float) -> None:
        how = "get" if target.is_request else "put"
        words = [rig.endpoint, target.key, how, str(RATE), str(seconds)]
        self._payload = valid(target.kind)
        self._clients = [
            subprocess.Popen(
                [sys.executable, str(CLIENT), *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for _ in range(num_clients)
        ]
        self.sent = 0

    def __enter__(self) -> "Flood":
        for client in self._clients:
            assert client.stdin is not None
            assert client.stdout is not None
            client.stdin.write(self._payload)
            client.stdin.close()
            client.stdout.readline()  # it is connected
        return self

    def __exit__(self, *_: object) -> None:
        for client in self._clients:
            assert client.stdout is not None
            self.sent += int(client.stdout.readline() or 0)
            client.wait(60.0)
            client.stdout.close()


def _press_stop(rig: Rig) -> float | None:
    """Ask for a stop; seconds until the answer, None where none came."""
    began_s = time.monotonic()
    try:
        rig.ask(requests.BASE_STOP)
    except (Refused, RobotUnreachable):
        return None
    return time.monotonic() - began_s


def _stand(rig: Rig) -> None:
    rig.ask_patiently(requests.BASE_STOP)
    rig.wait(lambda: rig.speed < STANDS_MPS, 10.0, "the robot stands")


def _drive_again(rig: Rig) -> None:
    """Resume as a person would, or restart the tour if rubbish has ended it."""
    rig.ask_patiently(requests.BASE_RESUME)
    rig.start_tour()
    rig.wait_for_driving(BACK_WITHIN_S)


def _put_map_back(rig: Rig) -> None:
    """Load the house's map again, as a person would: valid requests made and saved another."""
    if rig.pose is None or rig.pose.map != MAP:
        truth = rig.seen[-1].truth.pose
        rig.ask_patiently(requests.MAP_LOAD, LoadMap(name=MAP, pose=truth))
        rig.wait(lambda: rig.pose and rig.pose.map == MAP, BACK_WITHIN_S, "the map is back")


def flood_standing(rig: Rig) -> list[Outcome]:
    """Every key, by one client: how long a stop takes to be answered."""
    outcome = Outcome(f"{RATE} messages/s on each key and request in turn", "", stood_s=0.0)
    _stand(rig)
    before, restarts = rig.saved(), rig.restarts
    delays: list[float] = []
    sent = 0
    for target in targets(ROBOT):
        flood = Flood(rig, target, 1, FLOOD_S)
        with flood:
            for _ in range(3):
                time.sleep(FLOOD_S / 6.0)
                delay = _press_stop(rig)
                if delay is None or delay > ANSWERED_WITHIN_S:
                    outcome.wrong.append(f"{target.key}: stop answered after {delay} s")
                delays.append(delay if delay is not None else 2.0)
        sent += flood.sent
    if rig.restarts != restarts:
        outcome.wrong.append(f"services ended: {rig.restarts}, before {restarts}")
    _put_map_back(rig)
    outcome.lost = [one for one in lost(before, rig.saved()) if "poses.toml" not in one]
    began_s = time.monotonic()
    _drive_again(rig)
    outcome.back_s = time.monotonic() - began_s
    outcome.happened = (
        f"{sent / len(targets(ROBOT)) / FLOOD_S:.0f}/s got out; stop answered after "
        f"{1000 * np.median(delays):.0f} ms, at most {1000 * max(delays):.0f} ms"
    )
    return [outcome]


def flood_driving(rig: Rig) -> Iterator[Outcome]:
    """Some keys, by four clients, while the robot drives: how long until it stands."""
    by_name = {target.key.split("/", 2)[2]: target for target in targets(ROBOT)}
    for name in DRIVING_KEYS:
        outcome = Outcome(f"4 x {RATE}/s on {name}, then a stop", "")
        try:
            rig.wait_for_driving()
            before = rig.saved()
            with Flood(rig, by_name[name], 4, FLOOD_S) as flood:
                time.sleep(FLOOD_S / 3.0)
                began_s = time.monotonic()
                delay = _press_stop(rig)
                rig.wait(lambda at=began_s: rig.stood_after(at) is not None, 10.0, "it stands")
                outcome.stood_s = rig.stood_after(began_s)
            if delay is None or delay > ANSWERED_WITHIN_S:
                late = "not answered" if delay is None else f"answered after {delay:.1f} s"
                outcome.wrong.append(f"stop {late}")
            if outcome.stood_s is not None and outcome.stood_s > COMMAND_LOST_S + GRAIN_S:
                outcome.wrong.append(f"stood only after {outcome.stood_s:.2f} s")
            _stand(rig)
            resumed_s = time.monotonic()
            _drive_again(rig)
            outcome.back_s = time.monotonic() - resumed_s
            outcome.lost = [one for one in lost(before, rig.saved()) if name[4:9] not in one]
            answered = (
                "the stop was not answered"
                if delay is None
                else f"the stop was answered after {1000 * delay:.0f} ms"
            )
            outcome.happened = f"{flood.sent / 4 / FLOOD_S:.0f}/s from each got out; {answered}"
        except Missing as missing:
            outcome.wrong.append(f"{missing} ({describe(rig)})")
        yield outcome


def malformed(rig: Rig) -> list[Outcome]:
    """Broken payloads on every key: dropped or refused; nothing moves, ends or is lost."""
    outcome = Outcome("malformed messages on each key and request", "")
    _stand(rig)
    before, restarts, began_s = rig.saved(), rig.restarts, time.monotonic()
    num_sent = 0
    bus = rig.connection.bus
    for target in targets(ROBOT):
        for what, payload in broken(target):
            num_sent += 1
            if not target.is_request:
                bus.put(target.key, payload, "", Qos.STATE)
            else:
                _expect_refusal(rig, target, what, payload, outcome)
    _see_that_nothing_happened(rig, before, restarts, began_s, outcome)
    outcome.happened = f"{num_sent} payloads: all refused or dropped and counted"
    return [outcome]


def oversized(rig: Rig) -> list[Outcome]:
    """100 MB on every key."""
    outcome = Outcome("100 MB on each key and request", "refused, or dropped and counted")
    _stand(rig)
    before, restarts, began_s = rig.saved(), rig.restarts, time.monotonic()
    huge = b'{"name": "' + b"a" * HUGE_BYTES + b'"}'
    num_asked = num_refused = 0
    for target in targets(ROBOT):
        if target.is_request:
            # The sender's own link may break under it: then there is no answer.
            replies = _get(rig, target.key, huge)
            num_asked += 1
            num_refused += bool(replies) and replies[0].is_error
            if replies and not replies[0].is_error and not target.always:
                outcome.wrong.append(f"{target.key} took 100 MB")
        else:
            rig.connection.bus.put(target.key, huge, "", Qos.STATE)
    _see_that_nothing_happened(rig, before, restarts, began_s, outcome)
    outcome.happened = (
        f"dropped and counted; {num_refused} of {num_asked} requests were refused, "
        "the others broke the sender's own link or were a stop, which is obeyed"
    )
    return [outcome]


def foreign(rig: Rig) -> Iterator[Outcome]:
    """Words that were true once, or are of nobody: clocks, signs of life, recorded commands."""
    rig.wait_for_driving()
    heard: list[bytes] = []
    key = topics.COMMAND.key(ROBOT, "planner")
    listening = rig.connection.listen(key, lambda sample: heard.append(sample.payload))
    for what, act in (
        ("clock messages that leap", _leap),
        ("signs of life of older services", _pretend),
    ):
        outcome = Outcome(what, "nobody believes them; it drives on")
        before, restarts, began_s = rig.saved(), rig.restarts, time.monotonic()
        act(rig)
        time.sleep(HEARD_S)
        outcome.stood_s = rig.stood_after(began_s)
        if outcome.stood_s is not None and rig.speed < STANDS_MPS:
            outcome.wrong.append(f"it stands ({describe(rig)})")
        if rig.restarts != restarts:
            outcome.wrong.append(f"services ended: {rig.restarts}, before {restarts}")
        outcome.lost = lost(before, rig.saved())
        rig.wait_for_driving(BACK_WITHIN_S)
        yield outcome
    listening.close()
    outcome = Outcome("recorded commands, played back", "")
    _stand(rig)
    rig.ask_patiently(requests.BASE_RESUME)  # nothing sets off by itself
    before, restarts, began_s = rig.saved(), rig.restarts, time.monotonic()
    for source in ("planner", "teleop"):
        for payload in heard[-NUM_PLAYED:]:
            mime = codec.MIME["msgpack"]
            rig.connection.bus.put(topics.COMMAND.key(ROBOT, source), payload, mime, Qos.COMMAND)
            time.sleep(0.05)
    _see_that_nothing_happened(rig, before, restarts, began_s, outcome)
    outcome.happened = f"{2 * len(heard[-NUM_PLAYED:])} commands: none is followed"
    yield outcome


def _leap(rig: Rig) -> None:
    """One message each: this run far ahead, a run of the far future, a clock gone wild."""
    clock = rig.connection.latest(ROBOT, topics.CLOCK)
    if clock is None:
        raise Missing("the clock")
    for wrong in (
        msgspec.structs.replace(clock, stamp_ns=2**62),
        msgspec.structs.replace(clock, stamp_ns=2**62, epoch=2**62),
        msgspec.structs.replace(clock, rate=1e4),
    ):
        rig.connection.publish(ROBOT, topics.CLOCK, wrong)
        time.sleep(0.5)


def _pretend(rig: Rig) -> None:
    """Show a token of an older process of every service."""
    for service in rig.supervisor.children:
        rig.connection.bus.declare_token(topics.ALIVE.key(ROBOT, service, "elder-77-1"))


def _expect_refusal(rig: Rig, target: Target, what: str, payload: bytes, outcome: Outcome) -> None:
    replies = _get(rig, target.key, payload)
    obeyed = target.always or (what == "nothing" and target.accepts(b""))
    if len(replies) != 1:
        outcome.wrong.append(f"{target.key}: {len(replies)} answers to {what}")
    elif not replies[0].is_error:
        if not obeyed:
            outcome.wrong.append(f"{target.key} took {what}")
    elif _code(replies[0]) not in REFUSALS:
        outcome.wrong.append(f"{target.key} said {_code(replies[0])} to {what}")


def _get(rig: Rig, key: str, payload: bytes) -> list[Reply]:
    replies: list[Reply] = []
    done = threading.Event()
    # 100 MB take a while to get there.
    rig.connection.bus.get(key, payload, "", PATIENCE_S, replies.append, done.set)
    done.wait(PATIENCE_S + 2.0)
    return replies


def _code(reply: Reply) -> str:
    try:
        return codec.decode(ErrorReply, reply.payload, reply.encoding).code
    except codec.BadPayload:  # the network itself says that nobody answered
        return reply.payload.decode(errors="replace")


def _see_that_nothing_happened(
    rig: Rig, before: Saved, restarts: dict[str, int], began_s: float, outcome: Outcome
) -> None:
    time.sleep(2.0)
    fastest = rig.fastest_between(began_s, time.monotonic())
    if fastest > STANDS_MPS:
        outcome.wrong.append(f"it moved with {fastest:.2f} m/s")
    outcome.stood_s = 0.0
    if rig.restarts != restarts:
        outcome.wrong.append(f"services ended: {rig.restarts}, before {restarts}")
    outcome.lost = lost(before, rig.saved())
    resumed_s = time.monotonic()
    _drive_again(rig)
    outcome.back_s = time.monotonic() - resumed_s
