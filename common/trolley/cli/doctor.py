"""`trolley doctor`: what is wrong, and what to do about it."""

import dataclasses
import shutil
import sys
import textwrap
from collections import Counter
from typing import Any

import click

from trolley.cli import exits
from trolley.cli.options import FloatRange, given, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.cli.show import Progress, counted, print_json
from trolley.config import ConfigError
from trolley.connection import DEFAULT_ENDPOINT, Target, find_target
from trolley.doctor import Finding, Level
from trolley.doctor.computer_facts import Host
from trolley.doctor.examine import examine_host, examine_robots, look_around, trying
from trolley.doctor.trial import check_trial
from trolley.runtime.endpoints import is_far

LISTEN_S = 3.0
WIDEST, NARROWEST = 100, 40
_COLOURS = {Level.PROBLEM: "red", Level.WARNING: "yellow", Level.NOTE: "cyan", Level.OK: "green"}
_WORDS = {Level.PROBLEM: "problem", Level.WARNING: "warning", Level.NOTE: "note", Level.OK: "fine"}


@dataclasses.dataclass(frozen=True)
class Row:
    """A finding and the robot that it is about, "" for this computer."""

    robot: str
    finding: Finding


@click.command(name="doctor")
@click.option("-v", "--verbose", is_flag=True, help="Show what is fine, too.")
@click.option(
    "--seconds",
    default=LISTEN_S,
    show_default=True,
    type=FloatRange(1.0, 60.0),
    help="How long to listen to a robot.",
)
@where_options
@json_option
@reports_errors
def doctor_command(verbose: bool, seconds: float, as_json: bool) -> None:
    """Look for problems with this computer and the robot, and say what to do.

    It changes nothing, and works even when nothing is running. The exit code is 1 if there is a
    problem; warnings and notes do not count.
    """
    progress = Progress()
    progress.show("Checking this computer ...")
    place = look_around(given("config"), Host())
    with trying(place) as trial:
        found = [Row("", finding) for finding in examine_host(place)]
        progress.show(f"Listening for {seconds:g} s ...", "listening")
        robots = examine_robots(place, _target(), seconds, is_wanted=_is_wanted())
        found += [Row(name, finding) for name, findings in robots for finding in findings]
        progress.show("Testing the settings ...", "trying")
        found += [Row("", finding) for finding in check_trial(trial.outcome())]
    progress.clear()
    found.sort(key=lambda row: -row.finding.level)
    numbers = Counter(row.finding.level for row in found)
    if as_json:
        print_json(_plain(found, numbers))
    else:
        _print(found, numbers, verbose=verbose)
    if numbers[Level.PROBLEM]:
        raise SystemExit(exits.FAILED)


def _is_wanted() -> bool:
    """Whether somebody asked for a robot, or a router, by name."""
    return bool(given("robot") or given("connect"))


def _target() -> Target:
    """Where to look; a configuration that cannot be used is no reason to look nowhere."""
    try:
        return find_target(given("robot"), given("connect"), given("config"))
    except ConfigError:
        endpoints = tuple(given("connect") or (DEFAULT_ENDPOINT,))
        if any(map(is_far, endpoints)):  # it has to say where the keys are
            raise
        return Target(given("robot"), endpoints)


def _plain(found: list[Row], numbers: Counter[Level]) -> dict[str, Any]:
    findings = [
        {
            "level": row.finding.level.name.lower(),
            "robot": row.robot or None,
            "about": row.finding.about,
            "sentence": row.finding.sentence,
            "remedy": row.finding.remedy,
        }
        for row in found
    ]
    counted = {f"{level.name.lower()}s": numbers[level] for level in Level if level > Level.OK}
    return {**counted, "ok": numbers[Level.OK], "findings": findings}


def _print(found: list[Row], numbers: Counter[Level], *, verbose: bool) -> None:
    width = min(WIDEST, max(NARROWEST, shutil.get_terminal_size((80, 24)).columns))
    several = len({row.robot for row in found if row.robot}) > 1
    shown = [row for row in found if verbose or row.finding.level > Level.OK]
    for row, following in zip(shown, [*shown[1:], None], strict=True):
        finding = row.finding
        word = _WORDS[finding.level]
        robot = f"{row.robot}: " if row.robot and several else ""
        head = f"{word:<8} "
        text = f"{finding.about}: {robot}{finding.sentence}"
        lines = textwrap.wrap(
            head + text, width, subsequent_indent=" " * len(head), break_on_hyphens=False
        )
        colour = _COLOURS[finding.level]
        say(lines[0][: len(word)], fg=colour, nl=False)
        say(lines[0][len(word) :])
        for line in lines[1:]:
            say(line)
        # Several findings may have one remedy: it stands below the last of them.
        is_said_below = following is not None and following.finding.remedy == finding.remedy
        if finding.remedy and finding.level > Level.OK and not is_said_below:
            for line in textwrap.wrap(
                finding.remedy,
                width,
                initial_indent=" " * len(head) + "> ",
                subsequent_indent=" " * (len(head) + 2),
                break_on_hyphens=False,
            ):
                say(line, bold=True)
    if shown:
        say()
    say(_summary(numbers))
    sys.stdout.flush()


def _summary(numbers: Counter[Level]) -> str:
    bad = [
        counted(numbers[level], _WORDS[level])
        for level in (Level.PROBLEM, Level.WARNING, Level.NOTE)
        if numbers[level]
    ]
    number = numbers[Level.OK]
    fine = f"{counted(number, 'thing')} {'is' if number == 1 else 'are'} fine."
    return f"{', '.join(bad)}; {fine}" if bad else f"Nothing is wrong: {fine}"
