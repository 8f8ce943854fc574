"""Checks of a robot that runs, from what was heard of it for some seconds."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from trolley import codes, topics
from trolley.doctor.finding import Finding, note, ok, problem, warning
from trolley.messages import (
    BaseState,
    Clock,
    GoalStatus,
    Health,
    PoseEstimate,
    Proposal,
    Robot,
    TourStatus,
)
from trolley.messages.motion import PROTOCOL
from trolley.topics import Kind, Topic
from trolley.traffic import Expected, Flow, expected
from trolley.under_way import GOAL_GOES, TRIP_GOES

NEEDED = ("base", "localizer", "planner", "tour")
SLOW, FAST = 0.7, 1.5
"""Shares of the expected rate below and above which something is wrong."""
LATE_S, TOO_LATE_S = 0.5, 1.0
"""A pose over 1 s old is stale, and the robot stops."""
BUSY = 0.9
"""Share of a core from which on a service has no reserve."""
LOW_BATTERY = 0.2
LOG = "`journalctl -u 'trolley-*' -n 50`, or the terminal it was started in, says more."
OVERLOADED = "Is the computer overloaded? `trolley top` shows which service needs how much."


@dataclasses.dataclass(frozen=True)
class RobotFacts:
    """What was heard of a robot; topics are named as below the robot, such as `tf/laser`."""

    name: str
    seconds: float
    """How long was listened."""
    runs: Mapping[str, Sequence[str]] = dataclasses.field(default_factory=dict[str, list[str]])
    """The runs of each service that are alive."""
    flows: Mapping[str, Flow] = dataclasses.field(default_factory=dict[str, Flow])
    """What came."""
    kept: frozenset[str] = frozenset()
    """Of what the owner gave its latest value when asked."""
    late_s: Mapping[str, float] = dataclasses.field(default_factory=dict[str, float])
    """How old the newest message of a topic was when it arrived."""
    health: Mapping[str, Health] = dataclasses.field(default_factory=dict[str, Health])
    counted: Mapping[str, Mapping[str, int]] = dataclasses.field(
        default_factory=dict[str, dict[str, int]]
    )
    """By how much the counters of each service grew."""
    robot: Robot | None = None
    clock: Clock | None = None
    base: BaseState | None = None
    pose: PoseEstimate | None = None
    goal: GoalStatus | None = None
    trip: TourStatus | None = None
    proposals: Sequence[Proposal] = ()
    """What base has found wrong with robot.toml."""
    needs_map: bool = True
    """Whether it drives on a map."""
    needs_mqtt: bool = False
    """Whether robot.toml names a broker or a webhook."""

    @property
    def rate(self) -> float:
        """Seconds of the robot that pass in one real second."""
        return 1.0 if self.clock is None else self.clock.rate


def check_robot(facts: RobotFacts) -> list[Finding]:
    """All checks of a running robot."""
    if facts.robot is not None and facts.robot.replayed:
        text = f"{facts.name} is a recording that is played; no robot is there to be examined."
        return [note("robot", text)]
    return [
        *check_services(facts),
        *check_base(facts),
        *check_pose(facts),
        *check_proposals(facts),
        *check_rates(facts),
        *check_lateness(facts),
        *check_counters(facts),
    ]


def check_services(facts: RobotFacts) -> list[Finding]:
    """Whether each service is there, once, and answers."""
    found: list[Finding] = []
    for name in (*NEEDED, *(["mqtt"] if facts.needs_mqtt else [])):
        if name not in facts.runs and (name != "localizer" or facts.needs_map):
            start = "enable --now" if name == "mqtt" else "start"  # installing does not enable it
            found.append(
                problem(
                    name,
                    f"{name} is not running, or hangs.",
                    f"`sudo systemctl {start} trolley-{name}`, or `trolley run {name}`. {LOG}",
                )
            )
    for name, runs in facts.runs.items():
        found += _check_service(name, runs, facts)
    if facts.robot is not None and facts.robot.protocol != PROTOCOL:
        found.append(
            problem(
                "base",
                f"{facts.name} speaks version {facts.robot.protocol} of the protocol, this "
                f"program version {PROTOCOL}.",
                "Install the same version of Trolley on both computers.",
            )
        )
    return found


def _check_service(name: str, runs: Sequence[str], facts: RobotFacts) -> list[Finding]:
    found: list[Finding] = []
    if len(runs) > 1:
        found.append(
            problem(
                name,
                f"{name} runs {len(runs)} times (computer-process-start): "
                f"{', '.join(sorted(runs))}.",
                "End all but one of them.",
            )
        )
    health = facts.health.get(name)
    if health is None or f"health/{name}" not in facts.flows:
        return [
            *found,
            problem(
                name,
                f"{name} is running, but has been silent for {facts.seconds:.0f} s.",
                f"It hangs, or has only just started; if this persists, restart it. {LOG}",
            ),
        ]
    if health.state == "failed":
        found.append(problem(name, f"{name} cannot work: {_message(health)}", LOG))
    elif health.state == "degraded":
        found.append(warning(name, f"{name} is only partly working: {_message(health)}", LOG))
    elif health.state == "starting":
        found.append(note(name, f"{name} is still starting: {_message(health)}"))
    if health.cpu > BUSY:
        found.append(
            warning(name, f"{name} keeps a whole core busy ({health.cpu:.0%}).", OVERLOADED)
        )
    usage = f"{health.cpu:.0%} of a core, {health.rss / 1e6:.0f} MB"
    return found or [ok(name, f"{name} is fine ({usage}).")]


def _message(health: Health) -> str:
    return health.message or "it does not say why."


def _why(message: str) -> str:
    """What the localizer says, which is no sentence, as one; nothing where it says nothing."""
    return f" {message[:1].upper()}{message[1:].rstrip('.')}." if message else ""


def check_base(facts: RobotFacts) -> list[Finding]:
    """What keeps the robot from driving: stop, hardware, battery."""
    base = facts.base
    if base is None:
        return []
    why = base.message or codes.SENTENCES.get(base.reason, base.reason)
    found: list[Finding] = []
    for link in base.links:
        if link.state != "up":
            text = f"The {link.name} is not connected ({link.state}). {link.message}"
            found.append(
                problem("base", text.strip(), "Check its cable; `trolley detect` looks for it.")
            )
    if base.may_still_move:
        found.append(
            problem(
                "base", why, "Switch the motors off first; docs/obedience.md says what to do then."
            )
        )
    elif base.mode == "fault":
        found.append(problem("base", f"The robot cannot drive: {why}", LOG))
    elif base.mode == "stopped":
        found.append(
            warning("base", base.message or f"The robot is stopped: {why}", "`trolley resume`")
        )
    elif base.mode == "held":
        found.append(
            warning("base", f"The robot is held: {why}", "It continues when that is over.")
        )
    battery = base.battery
    if battery is not None and battery.fraction is not None and not battery.charging:
        text = f"The battery is at {battery.fraction:.0%}."
        is_low = battery.fraction < LOW_BATTERY
        found.append(warning("battery", text, "Charge it.") if is_low else ok("battery", text))
    if base.mode == "ok":
        found.append(ok("base", "The robot may drive."))
    return found


def check_pose(facts: RobotFacts) -> list[Finding]:
    """Whether the robot knows where it is."""
    pose = facts.pose
    if "localizer" not in facts.runs or not facts.needs_map:
        return []
    if pose is None or pose.map is None:
        return [
            problem(
                "localizer",
                "There is no pose.",
                "The localizer needs a map, scan and odometry: see the findings about those.",
            )
        ]
    help_it = "Show it where it is, in the viewer, or run `trolley pose find`."
    if pose.state == "lost":
        return [problem("localizer", f"The robot is lost.{_why(pose.message)}", help_it)]
    if pose.state == "searching":
        text = f"The robot is working out where it is.{_why(pose.message)}"
        return [warning("localizer", text, help_it)]
    if pose.state == "unsure":
        text = f"The robot is unsure where it is.{_why(pose.message)}"
        help_it = "Drive it a little, by hand or to a place, or show it where it is, in the viewer."
        return [warning("localizer", text, help_it)]
    return [
        ok(
            "localizer",
            f"The robot knows where it is; the map explains {pose.match:.0%} of a scan.",
        )
    ]


def check_proposals(facts: RobotFacts) -> list[Finding]:
    """Whether wheels and lidar still are as robot.toml says."""
    return [
        warning(
            "base",
            one.message,
            f"`trolley calibrate proposed --accept {one.id} --config robot.toml` takes it over."
            if one.settings
            else "Look whether a wheel, an encoder or the lidar has come loose.",
        )
        for one in facts.proposals
    ]


def check_rates(facts: RobotFacts) -> list[Finding]:
    """Whether everything comes as often as it should, and nothing more often."""
    found: list[Finding] = []
    for topic in topics.TOPICS:
        if topic.kind is not Kind.STREAM or topic is topics.HEALTH:
            continue
        owner = topic.first_owner
        names = [name for name in facts.flows if topic.match(_key(facts, name))]
        wanted = _wanted(topic, facts)
        for name in names:
            found += _check_flow(name, facts.flows[name], wanted, facts)
        is_due = owner in facts.runs and topic.num_parts == 0 and _is_due(topic, facts)
        if is_due and not names and wanted.low is not None:
            found.append(
                problem(
                    owner,
                    f"{topic.name} is not published, although {owner} is running.",
                    _silence_remedy(topic),
                )
            )
        elif is_due and not names and topic.name not in facts.kept and _must_be_kept(topic, facts):
            found.append(warning(owner, f"{owner} is running, but has no {topic.name}.", LOG))
    return found


def _key(facts: RobotFacts, name: str) -> str:
    return "/".join((topics.ROOT, facts.name, name))


def _is_due(topic: Topic[Any], facts: RobotFacts) -> bool:
    """Whether a topic is to be expected from this robot, in what it does now."""
    if topic.when_simulated:
        return facts.robot is not None and facts.robot.simulated
    if topic is topics.TOUR:
        return facts.trip is not None and facts.trip.state in TRIP_GOES
    if topic.when_driving and topic.num_parts == 0:
        return facts.goal is not None and facts.goal.state in GOAL_GOES
    return facts.needs_map or topic.first_owner != "localizer"


def _must_be_kept(topic: Topic[Any], facts: RobotFacts) -> bool:
    always = (topics.ROBOT, topics.POSES, topics.TOURS)
    return topic in always or (facts.needs_map and topic in (topics.MAP, topics.ZONES))


def _silence_remedy(topic: Topic[Any]) -> str:
    if topic is topics.SCAN:
        return "Is the lidar plugged in and turning? `trolley status` shows its connection."
    if topic is topics.POSE:
        return "The localizer needs a map, scan and odometry: see the findings about those."
    return LOG


def _wanted(topic: Topic[Any], facts: RobotFacts) -> Expected:
    """The expected rate in real seconds: a simulation may run faster or slower."""
    wanted = expected(topic)
    if wanted.is_each_scan:
        scan = facts.flows.get(topics.SCAN.name)
        return Expected(low=None if scan is None else scan.hz)
    if topic.when_driving and not _is_due(topic, facts):
        wanted = Expected(high=wanted.high)
    if topic.real_time:
        return wanted
    times = facts.rate
    return Expected(
        None if wanted.low is None else wanted.low * times,
        None if wanted.high is None else wanted.high * times,
    )


def _check_flow(name: str, flow: Flow, wanted: Expected, facts: RobotFacts) -> list[Finding]:
    # At 1 Hz three seconds hold two to four messages: one more or less says nothing.
    counted = flow.hz * facts.seconds
    low, high = wanted.low, wanted.high
    text = f"{name} arrives at {flow.hz:.1f} Hz"
    if low is not None and counted + 1.0 < SLOW * low * facts.seconds:
        return [warning("rates", f"{text}; {low:g} Hz is expected.", OVERLOADED)]
    if high is not None and counted - 1.0 > FAST * high * facts.seconds:
        return [
            warning(
                "rates",
                f"{text}; {high:g} Hz is the maximum.",
                "Are two programs publishing it? `trolley topic echo` shows the messages.",
            )
        ]
    return [ok("rates", f"{text}.")] if low is not None else []


def check_lateness(facts: RobotFacts) -> list[Finding]:
    """Whether what comes is fresh."""
    found: list[Finding] = []
    for name, late_s in facts.late_s.items():
        text = f"{name} is {late_s:.1f} s old when it arrives"
        if late_s > TOO_LATE_S * facts.rate:
            found.append(problem("rates", f"{text}, so the robot stops.", OVERLOADED))
        elif late_s > LATE_S * facts.rate:
            found.append(warning("rates", f"{text}.", OVERLOADED))
        else:
            found.append(ok("rates", f"{name} is {max(0.0, late_s):.2f} s old when it arrives."))
    return found


def check_counters(facts: RobotFacts) -> list[Finding]:
    """What the services drop or miss now, as far as they count it."""
    found: list[Finding] = []
    for service, counted in facts.counted.items():
        for name, number in sorted(counted.items()):
            times = "once" if number == 1 else f"{number} times"
            text = f"{service} counted {name} {times} in {facts.seconds:.0f} s"
            is_often = number > facts.seconds
            make = warning if is_often else note
            found.append(make("dropped", f"{text}.", f"It is dropping or missing something. {LOG}"))
    return found
