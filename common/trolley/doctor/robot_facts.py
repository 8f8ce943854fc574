"""Listens to robots for some seconds, and asks for what is not said by itself."""

import time
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from trolley import topics
from trolley.client import Robot
from trolley.connection import Connection
from trolley.doctor.robot import RobotFacts
from trolley.messages import Clock, Health
from trolley.runtime import codec
from trolley.topics import Kind, Topic
from trolley.traffic import Tally, Traffic, flows

M = TypeVar("M", bound=msgspec.Struct)

STAMPED: tuple[Topic[Any], ...] = (topics.SCAN, topics.ODOM, topics.POSE)
ASKED: tuple[Topic[Any], ...] = (topics.ROBOT, topics.MAP, topics.ZONES, topics.POSES, topics.TOURS)
"""What is said on change only, so that it has to be asked for."""


def listen(
    connection: Connection,
    names: Sequence[str],
    seconds: float,
    *,
    needs_map: bool = True,
    with_mqtt: str | None = None,
) -> list[RobotFacts]:
    """What is heard of some robots, of which `with_mqtt` should have its bridge."""
    traffic = Traffic()
    closers = [
        connection.listen("/".join((topics.ROOT, name, "**")), traffic.take) for name in names
    ]
    began_s = time.monotonic()
    earlier = {name: _health(connection, name) for name in names}
    time.sleep(max(0.0, began_s + seconds - time.monotonic()))
    tallies = traffic.so_far()
    now_s = time.monotonic()
    for closer in closers:
        closer.close()
    services = connection.services()
    found: list[RobotFacts] = []
    for name in names:
        mine = _below(tallies, name)
        robot = Robot.over(connection, name)
        health = _health(connection, name)
        clock = _last(mine, topics.CLOCK)
        proposals = robot.latest(topics.PROPOSALS)
        found.append(
            RobotFacts(
                name=name,
                seconds=now_s - began_s,
                runs={
                    service: runs for (owner, service), runs in services.items() if owner == name
                },
                flows=flows({}, mine, now_s - began_s, now_s),
                kept=frozenset(topic.name for topic in ASKED if robot.get(topic)),
                late_s=_lateness(mine, clock),
                health=health,
                counted=_growth(earlier[name], health),
                robot=robot.latest(topics.ROBOT),
                clock=clock,
                base=robot.latest(topics.BASE),
                pose=robot.latest(topics.POSE),
                goal=robot.latest(topics.GOAL),
                trip=robot.latest(topics.TOUR),
                proposals=() if proposals is None else proposals.proposals,
                needs_map=needs_map,
                needs_mqtt=name == with_mqtt,
            )
        )
    return found


def _below(tallies: Mapping[str, Tally], robot: str) -> dict[str, Tally]:
    """What is known of a robot's streams, by the topics' names below it."""
    found: dict[str, Tally] = {}
    for key, tally in tallies.items():
        row = topics.find(key)
        if row is not None and row[1] == robot and row[0].kind is Kind.STREAM:
            found["/".join(key.split("/")[2:])] = tally
    return found


def _last(tallies: Mapping[str, Tally], topic: Topic[M]) -> M | None:
    """The newest message of a topic that was heard, None if it is not understood."""
    tally = tallies.get(topic.name)
    if tally is None or tally.last is None:
        return None
    try:
        return codec.decode(topic.message, *tally.last)
    except codec.BadPayload:
        return None


def _lateness(tallies: Mapping[str, Tally], clock: Clock | None) -> dict[str, float]:
    """How old messages were when they arrived, by the robot's clock."""
    found: dict[str, float] = {}
    if clock is None:
        return found
    for topic in STAMPED:
        message: Any = _last(tallies, topic)
        if message is not None:
            since_s = tallies[topic.name].last_s - tallies[topics.CLOCK.name].last_s
            found[topic.name] = since_s * clock.rate + (clock.stamp_ns - message.stamp_ns) * 1e-9
    return found


def _health(connection: Connection, robot: str) -> dict[str, Health]:
    return {parts[0]: health for parts, health in connection.get(robot, topics.HEALTH).items()}


def _growth(before: Mapping[str, Health], after: Mapping[str, Health]) -> dict[str, dict[str, int]]:
    """By how much counters grew; a service that was started again begins at 0."""
    found: dict[str, dict[str, int]] = {}
    for service, health in after.items():
        was = before[service].counters if service in before else health.counters
        grown = {
            name: number - was.get(name, 0)
            for name, number in health.counters.items()
            if number > was.get(name, 0)
        }
        if grown:
            found[service] = grown
    return found
