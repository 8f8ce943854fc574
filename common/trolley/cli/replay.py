"""`trolley replay`: a recording plays under another robot's name."""

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trolley.cli import exits
from trolley.cli.options import FloatRange, given, json_option, robot_name, where_options
from trolley.cli.printing import say
from trolley.cli.record import patterns_option, until_signalled
from trolley.cli.robots import connected, reports_errors
from trolley.cli.show import Progress, counted, print_json, seconds_text
from trolley.config import ConfigError
from trolley.connection import Connection
from trolley.recording.layout import is_wanted

if TYPE_CHECKING:
    from trolley.recording.playback import Pace, Replica
    from trolley.recording.reader import Entry, RecordingFile
    from trolley.recording.stage import Stage

CLOCK_S = 0.1
SUFFIX = "-replay"
LONGEST_NAME = 32


@click.command(name="replay")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--speed",
    type=FloatRange(0.01, 1000.0),
    default=1.0,
    show_default=True,
    help="Recorded seconds per second.",
)
@click.option(
    "--as",
    "name",
    metavar="NAME",
    help=f"Its name [default: the recorded one plus {SUFFIX}].",
)
@click.option("--loop", is_flag=True, help="Repeat until Ctrl-C.")
@click.option(
    "--start",
    type=FloatRange(min=0.0),
    default=0.0,
    help="How far into the recording to start [s].",
)
@click.option(
    "--topics",
    "patterns",
    callback=patterns_option,
    metavar="NAMES",
    help="Only these, such as scan,odom,tf/*.",
)
@where_options
@json_option
@reports_errors
def replay_command(
    file: Path,
    speed: float,
    name: str | None,
    loop: bool,
    start: float,
    patterns: list[str],
    as_json: bool,
) -> None:
    """Play FILE, which `trolley record` wrote, as if it were a robot.

    It has the recorded robot's name plus -replay, or the one given by --as; never the name of a
    robot on the network. The viewer shows it like any other robot. Velocity commands are not
    played, and it answers no requests.
    """
    try:
        from trolley.recording.reader import BadRecording, RecordingFile
    except ImportError as error:
        raise ConfigError(f"replaying needs the extra trolley-robot[foxglove]: {error}") from error
    if given("robot"):
        raise click.UsageError("--robot has no effect here; --as NAME sets its name")
    try:
        recording = RecordingFile(file)
    except BadRecording as error:
        raise ConfigError(str(error)) from error
    with connected() as connection, until_signalled() as should_end:
        play = _Play(recording, speed, start, patterns, should_end)
        code = play.on(connection, _name(name, recording.robot), loop=loop, as_json=as_json)
    raise SystemExit(code)


def _name(given_name: str | None, recorded: str) -> str:
    return robot_name(given_name or recorded[: LONGEST_NAME - len(SUFFIX)] + SUFFIX)


class _Play:
    """A recording that is being played."""

    def __init__(
        self,
        recording: "RecordingFile",
        speed: float,
        start_s: float,
        patterns: Sequence[str],
        should_end: Callable[[], bool],
    ) -> None:
        self._recording = recording
        self._speed = speed
        self._start_ns = round(start_s * 1e9)
        self._patterns = patterns
        self._should_end = should_end
        self._num_messages = 0
        self._turns = 0
        self._line = Progress()

    def on(self, connection: Connection, name: str, *, loop: bool, as_json: bool) -> int:
        """Play it under a name; the exit code."""
        from trolley.recording.stage import Stage
        from trolley.runtime.clash import is_one_per_host

        there = {service for robot, service in connection.services(name) if robot == name}
        if not all(map(is_one_per_host, there)):
            raise ConfigError(
                f"there is a robot called {name} already; give another name with --as"
            )
        if not as_json:
            say(f"Playing {self._recording.path} as robot {name}. Ctrl-C ends it.")
        with closing(Stage(connection, name)) as stage:
            has_begun = self._turn(stage)
            while loop and has_begun and not self._is_over(stage):
                self._turn(stage)
            usurper = stage.usurper
        damage = self._recording.damage.sentences()
        for sentence in () if as_json else damage:
            say(sentence, err=True, fg="yellow")
        if usurper is not None:
            text = f"A robot called {name} has come up, so the replay has ended."
            say(text, err=True, fg="red")
            return exits.FAILED
        if not has_begun:
            say("Nothing was played: --start is past the end.", err=True, fg="red")
            return exits.FAILED
        if as_json:
            print_json({"robot": name, "messages": self._num_messages, "damage": damage})
            return exits.OK
        say(f"Played {counted(self._num_messages, 'message')}.")
        return exits.OK

    def _is_over(self, stage: "Stage") -> bool:
        return self._should_end() or stage.usurper is not None

    def _turn(self, stage: "Stage") -> bool:
        """Play it once; False where there was nothing to play."""
        from trolley.recording.playback import Pace, Replica

        # Different for each turn of each process, so that receivers notice the new beginning.
        stage.replica = replica = Replica(stage.name, time.time_ns() // 1_000_000 + self._turns)
        self._turns += 1
        entries = self._wanted()
        first = self._skip(entries, replica)
        if first is None:
            return False
        pace = Pace(self._speed)
        pace.begin(first.at_ns, time.monotonic_ns())
        clock = _Clock(stage, pace, self._progress)
        for entry in replica.kept():
            stage.publish(entry)
        for entry in itertools.chain([first], entries):
            while not self._is_over(stage):
                wait_s = pace.wait_s(entry.at_ns, time.monotonic_ns())
                stage.serve(min(wait_s, clock.due_s))
                clock.publish_when_due()
                if wait_s <= 0.0:
                    break
            if self._is_over(stage):
                break
            made = replica.take(entry)
            clock.publish_new_epoch()
            if made is not None:
                stage.publish(made)
                self._num_messages += 1
            pace.played(entry.at_ns, time.monotonic_ns())
        self._line.clear()
        return True

    def _wanted(self) -> "Iterator[Entry]":
        return (e for e in self._recording.entries() if is_wanted(e.name, self._patterns))

    def _skip(self, entries: "Iterator[Entry]", replica: "Replica") -> "Entry | None":
        """Learn what was said before the start; the first message to play."""
        begin_ns: int | None = None
        for entry in entries:
            begin_ns = entry.at_ns if begin_ns is None else begin_ns
            if entry.at_ns - begin_ns >= self._start_ns:
                return entry
            replica.take(entry)
        return None

    def _progress(self, now_ns: int, rate: float) -> None:
        span = self._recording.span_ns
        text = counted(self._num_messages, "message")
        if span is not None:
            passed_s, whole_s = (now_ns - span[0]) * 1e-9, (span[1] - span[0]) * 1e-9
            text = f"{passed_s:.0f} of {seconds_text(whole_s)}, {text}"
        if rate < self._speed:
            text += f", at speed {rate:.2g}: this computer cannot go faster"
        self._line.show(text)


class _Clock:
    """The clock of the robot that is played."""

    def __init__(
        self, stage: "Stage", pace: "Pace", progress: Callable[[int, float], None]
    ) -> None:
        self._stage = stage
        self._pace = pace
        self._progress = progress
        self._at_s = 0.0
        self._epoch: int | None = None
        self._publish()

    @property
    def due_s(self) -> float:
        """How long until the clock is due again."""
        return max(0.0, self._at_s - time.monotonic())

    def publish_when_due(self) -> None:
        """Tell it ten times a second."""
        if self.due_s <= 0.0:
            self._publish()

    def publish_new_epoch(self) -> None:
        """Tell it at once where base was restarted, before what counts by the new epoch."""
        if self._stage.replica.epoch != self._epoch:
            self._publish()

    def _publish(self) -> None:
        self._at_s = time.monotonic() + CLOCK_S
        self._epoch = self._stage.replica.epoch
        now_ns = self._pace.now(time.monotonic_ns())
        clock = self._stage.replica.clock(now_ns, self._pace.rate)
        if clock is not None:
            self._stage.publish_clock(clock)
        self._progress(now_ns, self._pace.rate)
