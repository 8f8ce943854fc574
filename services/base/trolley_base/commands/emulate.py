"""`trolley emulate`: boards and lidars on pseudo terminals, in a simulated world."""

import os
import select
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from trolley import worlds
from trolley.cli.demo_robot import pose_option
from trolley.cli.options import given, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import reports_errors
from trolley.cli.running import say_ended
from trolley.config import RobotConfig, load_config
from trolley.connection import Target, find_target
from trolley.geometry import Pose2D
from trolley.interrupts import Interrupts
from trolley.supervision import Supervision, end_with_parent
from trolley_base.description import footprint_of
from trolley_base.emulators import (
    DeviceError,
    EmulatedRobot,
    FaultError,
    Mount,
    RobotInWorld,
    WheelFacts,
)
from trolley_base.emulators.advice import base_settings, describe_ports
from trolley_base.emulators.catalogue import BOARDS, LEFT_OUT, LIDARS
from trolley_base.emulators.faults import KINDS
from trolley_base.emulators.pseudo_terminal import PortError
from trolley_base.emulators.truth import TruthPublisher
from trolley_base.world import WorldError
from trolley_base.world.world_file import load_world

POLL_S = 0.2


def _epilog() -> str:
    options = {
        f"{kind}:{name}": text
        for kind, board in BOARDS.items()
        for name, text in board.options.items()
    }
    lists = {"Options of devices (several: linorobot:quiet,exact)": options, "Faults": KINDS}
    devices = f"Devices: {', '.join(BOARDS)}; {', '.join(LIDARS)}."
    blocks = [devices]
    for title, known in lists.items():
        wide = max(map(len, known))
        rows = [f"  {name:<{wide}}  {text}" for name, text in known.items()]
        blocks.append("\n".join(["\b", f"{title}:", *rows]))
    return "\n\n".join(blocks)


def _network_option(
    _context: click.Context, _parameter: click.Parameter, texts: tuple[str, ...]
) -> dict[str, str]:
    """Read DEVICE=tcp:PORT."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, place = text.partition("=")
        if not equals:
            raise click.BadParameter(f"{text!r} is not DEVICE=tcp:PORT")
        found[name] = place
    return found


@click.command(name="emulate", epilog=_epilog())
@click.argument("devices", nargs=-1, required=True, metavar="DEVICE[:OPTION,...]...")
@click.option(
    "--world",
    default="apartment.toml",
    show_default=True,
    help="A world file, or the name of one that ships with Trolley.",
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, help="Fixes the world.")
@click.option("--start", callback=pose_option, metavar="X,Y,YAW", help="Where the robot starts.")
@click.option(
    "--laser",
    callback=pose_option,
    metavar="X,Y,YAW",
    help="Where its lidar sits in base_link [default: as --config says, else 0,0,0].",
)
@click.option(
    "--ports",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder in which the ports appear [default: a new one].",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="DEVICE:KIND[=VALUE][@S][+S]",
    help="What goes wrong, from which second on and for how long (may be repeated).",
)
@click.option(
    "--network",
    multiple=True,
    callback=_network_option,
    metavar="DEVICE=tcp:PORT",
    help="A device that is reached over the network, tcp:PORT or udp:PORT (may be repeated).",
)
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
@where_options
@reports_errors
def emulate_command(
    devices: tuple[str, ...],
    quiet: bool,
    ports: Path | None,
    faults: tuple[str, ...],
    network: dict[str, str],
    **where: Any,
) -> None:
    """Emulate motor boards and lidars on pseudo-terminals, in a simulated world, until Ctrl-C.

    They share one robot: the board moves it, the lidars see what is around it. With --config,
    footprint, lidar's pose and wheels are those of that file. With --robot or --config it publishes
    sim/truth. Faults can also be typed while it runs, in the form that --fault takes.
    """
    end_with_parent()
    if not quiet:
        for name, why in LEFT_OUT.items():
            say(f"{name} cannot be emulated: {why}", err=True, fg="yellow")
    path: Path | None = given("config")
    config = None if path is None else load_config(path)
    interrupts = Interrupts()
    try:
        body = _body(config, **where)
        tell = _say_nothing if quiet else say
        robot = EmulatedRobot(devices, body, ports, tell, network)
        for fault in faults:
            robot.fault(fault)
        with interrupts.handled(), ExitStack() as stack:
            stack.enter_context(robot)
            if not quiet:
                _announce(robot)
            target = _target()
            if target is not None:
                publisher = TruthPublisher(target, body.world.name, robot.truth, tell)
                stack.enter_context(publisher)
            _serve(robot)
    except (DeviceError, FaultError, WorldError, FileNotFoundError, PortError) as error:
        raise click.UsageError(str(error)) from error
    except KeyboardInterrupt:
        if not quiet:
            say_ended(interrupts, "The devices are gone.")


def _body(
    config: RobotConfig | None, world: str, seed: int, start: Pose2D | None, laser: Pose2D | None
) -> RobotInWorld:
    name = world if world.endswith(".toml") else f"{world}.toml"
    options: dict[str, Any] = {"world": load_world(worlds.find(name)), "seed": seed, "start": start}
    turns_back = False
    if config is not None:
        lidar, wheels = config.base.lidar, config.base.chassis.wheels
        options["footprint"] = footprint_of(config)
        laser = laser or lidar.pose.as_pose()
        turns_back = lidar.upside_down is not lidar.reversed
        if wheels is not None:
            options["wheels"] = WheelFacts(
                wheels.ticks_per_revolution, wheels.diameter_m, wheels.track_m
            )
    return RobotInWorld(mount=Mount(laser or Pose2D.identity(), turns_back), **options)


def _target() -> Target | None:
    """Whose truth is published where; None if nobody asked for that."""
    if not (given("robot") or given("connect") or given("config")):
        return None
    target = find_target(given("robot"), given("connect"), given("config"))
    if target.robot is None:
        raise click.UsageError("--connect needs --robot NAME: whose sim/truth this is")
    return target


def _say_nothing(_line: str) -> None:
    """In place of `say`, where nothing is to be said."""


def _announce(robot: EmulatedRobot) -> None:
    for line in describe_ports(robot):
        say(line)
    say()
    say("In a robot.toml:")
    say()
    say_block(base_settings(robot))
    say(
        "Ctrl-C ends it. Type a fault, such as "
        f"{next(iter(robot.devices))}:silence+2, to make trouble."
    )


def _serve(robot: EmulatedRobot) -> None:
    """Take faults that are typed, until Ctrl-C."""
    typed = b""
    source = [] if sys.stdin is None or sys.stdin.closed else [sys.stdin.fileno()]
    supervision = Supervision()
    supervision.ready()
    while True:
        supervision.alive()
        robot.check()
        readable, _, _ = select.select(source, [], [], POLL_S)
        if not readable:
            continue
        data = os.read(source[0], 4096)
        if not data:
            source = []
        *lines, typed = (typed + data).split(b"\n")
        for line in filter(None, (line.decode("utf-8", "replace").strip() for line in lines)):
            try:
                robot.fault(line)
            except FaultError as error:
                say(str(error), err=True, fg="red")
