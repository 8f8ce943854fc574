"""`trolley record`: what a robot publishes, into a file that Foxglove and `trolley replay` play."""

import errno
import signal
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from trolley.cli import exits
from trolley.cli.options import FloatRange, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import Progress, counted, print_json, seconds_text
from trolley.client import Robot
from trolley.config import ConfigError
from trolley.files import why_not_written
from trolley.recording.layout import bad_pattern
from trolley.recording.listener import Listener

if TYPE_CHECKING:
    from trolley.recording.recorder import Recorder
    from trolley.recording.writer import RecordingWriter

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
FLUSH_S = 1.0
POLL_S = 0.1
CLOCK_PATIENCE_S = 1.5
SILENCE_S = 3.0


def patterns_option(
    _context: click.Context, _parameter: click.Parameter, text: str | None
) -> list[str]:
    """Names of topics such as `scan,tf/*`."""
    patterns = [part.strip("/ ") for part in text.split(",")] if text is not None else []
    wrong = bad_pattern(patterns)
    if wrong is not None:
        raise click.BadParameter(
            f"there is no topic {wrong!r}; `trolley topic list --all` lists them"
        )
    return patterns


@contextmanager
def until_signalled() -> Generator[Callable[[], bool]]:
    """Whether a signal asked this process to end; nothing is interrupted in its midst."""
    signals: list[int] = []

    def note(number: int, _frame: object) -> None:
        signals.append(number)

    before = {number: signal.signal(number, note) for number in ENDING}
    try:
        yield lambda: bool(signals)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@click.command(name="record")
@click.argument("file", required=False, type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--topics",
    "patterns",
    callback=patterns_option,
    metavar="NAMES",
    help="Only these, such as scan,odom,tf/*; clock and robot are always recorded.",
)
@click.option(
    "--seconds",
    type=FloatRange(min=0.0, min_open=True),
    metavar="SECONDS",
    help="For how long; else until Ctrl-C.",
)
@where_options
@json_option
@reports_errors
def record_command(
    file: Path | None, patterns: list[str], seconds: float | None, as_json: bool
) -> None:
    """Record what a robot publishes into FILE, until Ctrl-C.

    The file is MCAP: `trolley replay` plays it, and Foxglove opens it. Without FILE it is
    ROBOT-DATE.mcap in the current folder; an existing file is never overwritten. After a crash or a
    power cut only the last one or two seconds are missing.
    """
    with one_robot() as robot:
        path = file or Path(f"{robot.name}-{datetime.now().astimezone():%Y-%m-%d-%H%M%S}.mcap")
        code = _record(robot, path, patterns, seconds, as_json=as_json)
    raise SystemExit(code)


def _record(
    robot: Robot, path: Path, patterns: Sequence[str], seconds: float | None, *, as_json: bool
) -> int:
    try:
        from trolley.recording.recorder import Recorder
    except ImportError as error:
        raise ConfigError(f"recording needs the extra trolley-robot[foxglove]: {error}") from error
    listener = Listener(robot.connection, robot.name)
    try:
        with _open(path, robot.name) as writer, until_signalled() as should_end:
            recorder = Recorder(writer, robot.name, patterns)
            try:
                _follow(listener, recorder, writer, should_end, seconds)
                writer.finish()
            except OSError as error:
                writer.abandon()
                _say_why(path, writer, error)
                return exits.FAILED
    finally:
        listener.close()
    if not writer.num_messages:
        path.unlink()
        say(f"Nothing was received from {robot.name}.", err=True, fg="red")
        return exits.FAILED
    left = {**recorder.counts, "lost, the disk is too slow": listener.lost}
    left = {reason: number for reason, number in left.items() if number}
    if as_json:
        about = {"file": str(path), "messages": writer.num_messages, "bytes": writer.size}
        print_json({**about, "left": left})
        return exits.OK
    say(f"{path}: {counted(writer.num_messages, 'message')}, {writer.size / 1e6:.1f} MB.")
    for reason, number in left.items():
        say(f"{counted(number, 'message')}: {reason}", err=True, fg="yellow")
    return exits.OK


def _open(path: Path, robot: str) -> "RecordingWriter":
    from trolley.recording.writer import RecordingWriter

    try:
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        return RecordingWriter(path, robot, {"recorded_at": now})
    except FileExistsError as error:
        raise ConfigError(f"{path} already exists; name another file") from error
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {why_not_written(path, error)}") from error


def _follow(
    listener: Listener,
    recorder: "Recorder",
    writer: "RecordingWriter",
    should_end: Callable[[], bool],
    seconds: float | None,
) -> None:
    """Record until told to end, and what waits by then."""
    progress, started_s = Progress(), time.monotonic()
    flush_at_s, heard_s = started_s + FLUSH_S, started_s
    clock = listener.await_clock(CLOCK_PATIENCE_S, should_end)
    if clock is not None:
        recorder.update_clock(clock.sample, clock.arrived_ns)
    is_over = False
    while True:
        heard = listener.take(0.0 if is_over else POLL_S)
        if heard is not None:
            heard_s = time.monotonic()
            recorder.take(heard.sample, heard.arrived_ns, time.time_ns(), is_latest=heard.is_latest)
        elif is_over:
            break
        now_s = time.monotonic()
        if now_s >= flush_at_s:
            flush_at_s = now_s + FLUSH_S
            writer.flush()
            silent_s = now_s - heard_s
            progress.show(
                f"{seconds_text(now_s - started_s)}, {counted(writer.num_messages, 'message')}, "
                f"{writer.size / 1e6:.1f} MB; "
                + ("Ctrl-C ends it" if silent_s < SILENCE_S else _silence(silent_s)),
                "silent" if silent_s >= SILENCE_S else "",
            )
        if not is_over and (should_end() or (seconds is not None and now_s - started_s >= seconds)):
            is_over = True
            listener.close()
    progress.clear()


def _silence(seconds: float) -> str:
    return f"nothing was received from the robot for {seconds_text(seconds)}"


def _say_why(path: Path, writer: "RecordingWriter", error: OSError) -> None:
    full = "The disk is full except for what the robot needs"
    why = full if error.errno == errno.ENOSPC else f"It cannot be written ({error})"
    say(err=True)
    say(
        f"{why}, so recording has stopped. {path} is complete up to here: {writer.size / 1e6:.1f} "
        "MB.",
        err=True,
        fg="red",
    )
