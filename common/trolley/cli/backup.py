"""`trolley backup` and `trolley restore`: all that a robot knows, as one file."""

import os
from contextlib import ExitStack
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

import click

from trolley.backup import FORMAT, BackupError, Manifest, Unpacked, save
from trolley.cli.options import given, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.cli.show import print_json
from trolley.config import ConfigError, find_config, load_config
from trolley.config.load import DEFAULT_PATH
from trolley.connection import Connection, RobotUnreachable, find_target
from trolley.runtime.clash import Run, host_name
from trolley.runtime.state import state_root
from trolley.topics import names_robot

state_option = click.option(
    "--state",
    type=click.Path(file_okay=False, path_type=Path),
    help="The state folder; else that of the robot.toml in use.",
)


@click.command(name="backup")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@state_option
@where_options
@json_option
@reports_errors
def backup_command(file: Path | None, state: Path | None, as_json: bool) -> None:
    """Save what the robot knows, and robot.toml, in FILE (a .tar.gz).

    That is saved places, tours, trips and their photos, zones, maps, the last pose and the viewer's
    links. The robot may keep running. FILE may be a folder; without it the backup goes into the
    current one. On an installed robot use sudo. Network certificates are not included.
    """
    config = find_config(given("config"))
    root = state or state_root(config)
    if not root.is_dir() and (config is None or not config.is_file()):
        raise click.ClickException(
            f"there is nothing to save: no {config or 'robot.toml'}, and no {root}; name them with "
            "--config and --state"
        )
    now = datetime.now().astimezone()
    target = _target(file, now)
    manifest = Manifest(
        format=FORMAT, made_at=now.isoformat(timespec="seconds"), version=version("trolley-robot")
    )
    try:
        _check_readable(root)
        saved = save(target, root, config, manifest)
    except BackupError as error:
        raise click.ClickException(str(error)) from error
    size = target.stat().st_size
    if as_json:
        print_json(
            {
                "file": str(target),
                "bytes": size,
                "files": saved.num_files,
                "left_out": list(saved.left_out),
            }
        )
        return
    for sentence in saved.left_out:
        say(sentence, err=True, fg="yellow")
    say(f"Saved {saved.num_files} files in {target} ({size / 1e3:.0f} kB).")


def _target(file: Path | None, now: datetime) -> Path:
    target = file or Path.cwd()
    if target.is_dir():
        target /= f"trolley-{host_name()}-{now:%Y%m%d-%H%M%S}.tar.gz"
    if target.exists():
        raise click.UsageError(f"{target} already exists; not overwritten")
    return target


def _check_readable(root: Path) -> None:
    """Refuse half a backup.

    Raises:
        BackupError: Some file is not for this user.
    """
    hidden = [path for path in (root, *root.rglob("*")) if not os.access(path, os.R_OK)]
    if root.exists() and hidden:
        raise BackupError(f"{hidden[0]} cannot be read by this user: use sudo")


@click.command(name="restore")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--state-only", is_flag=True, help="Leave robot.toml as it is.")
@state_option
@where_options
@json_option
@reports_errors
def restore_command(file: Path, state_only: bool, state: Path | None, as_json: bool) -> None:
    """Restore what `trolley backup` saved in FILE.

    FILE is checked completely first. The existing state is kept beside the new one under another
    name. Stop the services first, since they would overwrite what is restored; start them
    afterwards. On an installed robot use sudo.
    """
    config = find_config(given("config")) or DEFAULT_PATH
    root = (state or state_root(config)).absolute()
    _refuse_while_running()
    now = datetime.now().astimezone()
    try:
        unpacked = Unpacked(file, root, state_only=state_only)
        try:
            kept = _put_back(unpacked, root, None if state_only else config, now)
        finally:
            unpacked.close()
    except BackupError as error:
        raise click.ClickException(str(error)) from error
    if of_another := _of_another_robot(root, config):
        say(of_another, err=True, fg="yellow")
    if as_json:
        kept_names = [str(path) for path in kept]
        print_json({"file": str(file), "manifest": unpacked.manifest, "kept": kept_names})
        return
    made = f"made {unpacked.manifest.made_at} by Trolley {unpacked.manifest.version}"
    say(f"Restored {file} ({made}).")
    for path in kept:
        say(f"The previous state is kept: {path}")
    say("Now start the services again.")


def _put_back(unpacked: Unpacked, root: Path, config: Path | None, now: datetime) -> list[Path]:
    wants_config = config is not None and unpacked.config is not None
    if config is not None and wants_config:
        folder = next(path for path in config.parents if path.exists())
        if not os.access(folder, os.W_OK):
            raise BackupError(f"{folder} cannot be written by this user: use sudo, or --state-only")
    aside = unpacked.put_state(root, now)
    kept = [] if aside is None else [aside]
    if config is not None and wants_config:
        try:
            kept += unpacked.put_config(config, now)
        except BackupError as error:
            before = "" if aside is None else f" The previous state is kept: {aside}."
            raise BackupError(
                f"{error}. The state has been restored, robot.toml not or not all of it.{before}"
            ) from error
    return kept


def _of_another_robot(root: Path, config: Path) -> str | None:
    """A sentence where the robot of this robot.toml would find none of its state."""
    try:
        name = load_config(config).robot.name
    except ConfigError:
        return None
    folders = (one.name for one in root.iterdir() if one.is_dir() and one.name != "maps")
    others = sorted(filter(names_robot, folders))
    if not others or name in others:
        return None
    which = root / others[0] if len(others) == 1 else "one of them"
    return (
        f"This is the state of {', '.join(others)}, but {config} names the robot {name}: rename "
        f"{which} to {name} before you start the services, or it will know only the maps"
    )


def _refuse_while_running() -> None:
    """Refuse while a service of this host is alive.

    Raises:
        ClickException: Naming those that are.
    """
    try:
        target = find_target(given("robot"), given("connect"), given("config"))
    except ConfigError:
        return  # no service runs with such a robot.toml
    with ExitStack() as stack:
        try:
            connection = stack.enter_context(Connection(target.endpoints, 1.0))
        except RobotUnreachable:
            return
        services = connection.services()
    here = sorted(
        {
            service.removesuffix(f"-{host_name()}")
            for (_, service), ids in services.items()
            for run in map(Run.parse, ids)
            if run is not None and run.host == host_name()
        }
    )
    if here:
        raise click.ClickException(
            f"these services are running on this host: {', '.join(here)}. Stop them first "
            "(installed: sudo systemctl stop 'trolley-*'), or they will overwrite what is restored"
        )
