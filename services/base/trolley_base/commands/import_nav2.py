"""`trolley import nav2`: a robot.toml from the parameters of Nav2."""

from pathlib import Path

import click

from trolley.cli.robots import reports_errors
from trolley_base.commands.importing import output_options, write_settings
from trolley_base.importers.findings import Value
from trolley_base.importers.nav2 import read_nav2
from trolley_base.importers.settings import take_map


@click.command(name="nav2")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@output_options
@click.option(
    "--map",
    "map_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The map's YAML file, where FILE names none.",
)
@reports_errors
def import_nav2(
    file: Path, output: Path, force: bool, name: str, map_file: Path | None, as_json: bool
) -> None:
    """Write a robot.toml from a parameter file of Nav2 (ROS 2), such as nav2_params.yaml.

    It lists what it took, and what it did not and why. Boards and lidars are not Nav2's business:
    `trolley detect --write` finds them.
    """
    findings = read_nav2(file)
    if not findings.taken:
        raise click.BadParameter(
            f"{file} says nothing that Nav2 would read: give a file of its parameters, such as "
            "nav2_params.yaml",
            param_hint="FILE",
        )
    if map_file is not None:
        take_map(findings, Value(map_file, map_file, 1))
    elif findings.map_file is None and "planner.frame" not in findings.chosen:
        findings.note("No map is taken: give its YAML file with --map, or name it in [map] file.")
    write_settings(findings, output, name, force=force, as_json=as_json)
