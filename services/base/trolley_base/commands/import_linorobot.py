"""`trolley import linorobot`: a robot.toml from a linorobot's own files."""

from pathlib import Path

import click

from trolley.cli.robots import reports_errors
from trolley_base.commands.importing import output_options, write_settings
from trolley_base.importers.linorobot.hardware import DRIVES, LIDARS
from trolley_base.importers.linorobot.reading import read_linorobot


@click.command(name="linorobot")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@output_options
@click.option(
    "--base",
    envvar="LINOBASE",
    default="",
    metavar="|".join(DRIVES),
    help="Its drive [default: as LINOBASE says].",
)
@click.option(
    "--lidar",
    envvar="LINOLIDAR",
    default="",
    metavar="|".join(LIDARS),
    help="Its lidar [default: as LINOLIDAR says].",
)
@reports_errors
def import_linorobot(
    folder: Path, output: Path, force: bool, name: str, base: str, lidar: str, as_json: bool
) -> None:
    """Write a robot.toml from the files of a linorobot (ROS 1).

    FOLDER is its package, with launch, param and maps, or what you have of it. The files are only
    read, never run.
    """
    findings = read_linorobot(folder, base, lidar)
    if not findings.taken:
        raise click.BadParameter(
            f"{folder} holds no file of a linorobot that says anything: give the folder of the "
            f"package, with launch, param and maps, such as ~/linorobot_ws/src/linorobot. Of a "
            "linorobot2 (ROS 2), give `trolley import nav2` its "
            "linorobot2_navigation/config/navigation.yaml",
            param_hint="FOLDER",
        )
    write_settings(findings, output, name, force=force, as_json=as_json)
