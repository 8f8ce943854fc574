"""`trolley topic`: what is published, its content and its rate; publish something."""

import itertools
import statistics
import time
from typing import Any

import click

from trolley import topics
from trolley.cli import SuggestingGroup, exits
from trolley.cli.json_argument import read_json
from trolley.cli.options import FloatRange, json_option, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import Progress, as_json, counted, describe, print_json, print_table
from trolley.client import Robot
from trolley.codes import BUSY, Refused
from trolley.connection import Arrival
from trolley.runtime.endpoints import is_far
from trolley.suggestions import did_you_mean
from trolley.topics import Kind, Topic
from trolley.traffic import Traffic

LISTEN_S = 2.0
SECONDS = FloatRange(min=0.0, max=86_400.0, min_open=True)


def _complete(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    return [topic.name for topic in topics.TOPICS if topic.name.startswith(typed)]


topic_argument = click.argument("name", metavar="TOPIC", shell_complete=_complete)


@click.group(name="topic", cls=SuggestingGroup)
def topic_command() -> None:
    """Show what is published, or publish something.

    TOPIC is a key without the robot's name, such as scan or tf/laser.
    """


def _resolve(robot: Robot, name: str) -> tuple[Topic[Any], tuple[str, ...]]:
    """The row of the table and the chunks that vary; `*` and `{child}` stand for any."""
    chunks = ["*" if chunk.startswith("{") else chunk for chunk in name.strip("/").split("/")]
    found = topics.find("/".join((topics.ROOT, robot.name, *chunks)))
    if found is None:
        hint = did_you_mean(name, (topic.name for topic in topics.TOPICS))
        raise click.BadParameter(f"there is no topic {name!r}. {hint} See `trolley topic list`.")
    topic, _, parts = found
    return topic, parts


@topic_command.command(name="list")
@click.option("--all", "everything", is_flag=True, help="Also topics that nobody publishes now.")
@click.option(
    "--seconds", type=SECONDS, default=LISTEN_S, show_default=True, help="How long to listen."
)
@where_options
@json_option
@reports_errors
def list_topics(everything: bool, seconds: float, as_json: bool) -> None:
    """List what is published, with its rate."""
    traffic = Traffic()
    with one_robot() as robot:
        closer = robot.connection.listen("/".join((topics.ROOT, robot.name, "**")), traffic.take)
        Progress().show(f"Listening for {seconds:g} s ...")
        time.sleep(seconds)
        closer.close()
        heard = {key: tally.messages for key, tally in traffic.so_far().items()}
        rows = _rows(robot, heard, seconds, everything=everything)
    Progress().clear()
    if as_json:
        print_json(rows)
    else:
        names = [(r["topic"], r["message"], _rate(r), r["owner"]) for r in rows]
        print_table(("TOPIC", "MESSAGE", "NOW", "OWNER"), names)


def _rows(
    robot: Robot, heard: dict[str, int], seconds: float, *, everything: bool
) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for topic in topics.TOPICS:
        if topic.kind is not Kind.STREAM:
            continue
        matched = {key: topic.match(key) for key in heard}
        keys = {"/".join(key.split("/")[2:]): heard[key] for key in matched if matched[key]}
        # What is published on change only is silent most of the time, but its owner keeps it.
        for parts in robot.get(topic):
            keys.setdefault("/".join(topic.key(robot.name, *parts).split("/")[2:]), 0)
        if not keys and everything:
            keys = {topic.name: -1}
        for name, number in sorted(keys.items()):
            rows.append(
                {
                    "topic": name,
                    "message": topic.message.__name__,
                    "owner": topic.owner,
                    "hz": None if number < 0 else round(number / seconds, 2),
                    "published": number >= 0,
                    "nominal": topic.rate,
                }
            )
    return rows


def _rate(row: dict[str, Any]) -> str:
    if not row["published"]:
        return "-"
    return f"{row['hz']:.1f} Hz" if row["hz"] else "kept"


@topic_command.command(name="echo")
@topic_argument
@click.option(
    "-n",
    "--count",
    type=click.IntRange(min=1),
    metavar="NUMBER",
    help="Exit after this many messages.",
)
@click.option("--once", is_flag=True, help="Print one message: the latest, else the next.")
@click.option("--full", is_flag=True, help="Print arrays in full.")
@click.option(
    "--timeout",
    type=SECONDS,
    metavar="SECONDS",
    help="Exit with code 1 after this long without a message.",
)
@where_options
@json_option
@reports_errors
def echo_topic(
    name: str, count: int | None, once: bool, full: bool, timeout: float | None, as_json: bool
) -> None:
    """Print the messages of TOPIC as they arrive; arrays as numbers, with --json one line each."""
    left = 1 if once else count
    with one_robot() as robot:
        topic, parts = _resolve(robot, name)
        with robot.subscribe(topic, *parts) as messages:
            while left is None or left > 0:
                arrival = messages.next(timeout)
                if arrival is None:
                    _check_is_there(robot)
                    text = f"{name}: nothing was received in {timeout:g} s"
                    say(text, err=True, fg="red")
                    raise SystemExit(exits.FAILED)
                _print(topic, arrival, full=full, to_json=as_json)
                left = None if left is None else left - 1


def _check_is_there(robot: Robot) -> None:
    """Raise RobotUnreachable, naming others, where it is no robot that says nothing."""
    if not robot.connection.services(robot.name):
        raise robot.connection.unknown_robot(robot.name)


def _print(topic: Topic[Any], arrival: Arrival[Any], *, full: bool, to_json: bool) -> None:
    key = "/".join(topic.key(arrival.robot, *arrival.parts).split("/")[2:])
    if to_json:
        line = arrival.message if not arrival.parts else {"topic": key, "message": arrival.message}
        say_block(as_json(line, indent=None))
        return
    if arrival.parts:
        say(key, bold=True)
    say_block(describe(arrival.message, full=full))
    say("---")


@topic_command.command(name="hz")
@topic_argument
@click.option("--seconds", type=SECONDS, default=5.0, show_default=True, help="How long to listen.")
@where_options
@json_option
@reports_errors
def topic_rate(name: str, seconds: float, as_json: bool) -> None:
    """Measure how often and how evenly TOPIC arrives, and how large it is."""
    with one_robot() as robot:
        topic, parts = _resolve(robot, name)
        times: list[float] = []
        sizes: list[int] = []
        progress = Progress()
        subscription = robot.connection.subscribe(robot.name, topic, *parts, with_latest=False)
        with subscription as messages:
            end_s = time.monotonic() + seconds
            while (left_s := end_s - time.monotonic()) > 0.0:
                arrival = messages.next(left_s)
                if arrival is not None:
                    times.append(arrival.arrived_s)
                    sizes.append(arrival.size)
                    progress.show(f"{counted(len(times), 'message')}, {left_s:.0f} s left")
        progress.clear()
        if not times:
            _check_is_there(robot)
    result = _statistics(times, sizes, seconds)
    if as_json:
        print_json({"topic": name, **result})
    elif len(times) < 2:
        say(f"{counted(len(times), 'message')} in {seconds:g} s")
    else:
        say(
            f"{result['hz']:.2f} Hz, gaps {result['gap_min']:.3f} to {result['gap_max']:.3f} s "
            f"(deviation {result['gap_std']:.4f} s), {result['bytes']:.0f} bytes each, "
            f"{result['messages']} messages"
        )
    if not times:
        raise SystemExit(exits.FAILED)


@topic_command.command(name="pub")
@topic_argument
@click.argument("message", metavar="JSON")
@click.option(
    "--hz",
    type=FloatRange(min=0.0, max=100.0, min_open=True),
    metavar="RATE",
    help="Publish it again and again, this often, until Ctrl-C.",
)
@click.option(
    "-n", "--count", type=click.IntRange(min=1), metavar="NUMBER", help="End after this many times."
)
@click.option("--beside", is_flag=True, help="Publish even beside the service that owns TOPIC.")
@where_options
@reports_errors
def publish_topic(
    name: str, message: str, hz: float | None, count: int | None, beside: bool
) -> None:
    """Publish JSON on TOPIC.

    Such as: trolley topic pub cmd_vel/teleop '{"twist": {"vx": 0.1, "vy": 0, "wz": 0}, …}'

    Arrays may be lists of numbers. The stamp is robot time unless it is given.
    """
    with one_robot() as robot:
        topic, parts = _resolve(robot, name)
        if "*" in parts or topic.kind is Kind.TOKEN:
            raise click.BadParameter(f"{name!r} is not the key of one message")
        if not beside:
            _refuse_owned(robot, topic, parts)
        sent, began_s = 0, time.monotonic()
        left = count if count is not None or hz is not None else 1
        while left is None or sent < left:
            preset = {"stamp_ns": robot.now_ns() or 0}
            robot.publish(topic, read_json(message, topic.message, name, preset), *parts)
            sent += 1
            if left is None or sent < left:
                time.sleep(max(0.0, began_s + sent / (hz or 1.0) - time.monotonic()))
    said = counted(sent, "message")
    if not beside and not any(map(is_far, robot.connection.endpoints)):
        say(f"sent {said} on {name}")
        return
    say(
        f"sent {said} on {name}. Nobody confirms what is published: a router with rights drops "
        f"what this computer may not say (`trolley topic echo {name}` shows what comes)."
    )


def _refuse_owned(robot: Robot, topic: Topic[Any], parts: tuple[str, ...]) -> None:
    """Refuse to talk into what a running service says.

    Raises:
        Refused: `busy`, naming it.
    """
    is_free = "anyone" in topic.owner and parts not in topic.owned_parts
    if topic.kind is Kind.STORED or topic is topics.COMMAND or is_free:
        return
    owners = {owner for _, owner in robot.connection.services(robot.name)}
    for word in topic.owner.replace(",", " ").split():
        if word in owners or topic is topics.HEALTH:
            raise Refused(
                BUSY,
                f"{topic.name} is published by {topic.owner}, which is running: others would hear "
                "both. Stop it first, or add --beside.",
                service=topic.first_owner,
            )


def _statistics(times: list[float], sizes: list[int], seconds: float) -> dict[str, Any]:
    gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
    hz = len(gaps) / (times[-1] - times[0]) if gaps and times[-1] > times[0] else None
    return {
        "messages": len(times),
        "seconds": seconds,
        "hz": hz,
        "gap_min": min(gaps, default=None),
        "gap_max": max(gaps, default=None),
        "gap_std": statistics.pstdev(gaps) if gaps else None,
        "bytes": statistics.fmean(sizes) if sizes else None,
    }
