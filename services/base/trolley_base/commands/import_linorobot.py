"""`trolley import linorobot`: a robot.toml from a linorobot's own files."""

import re
from dataclasses import replace
from pathlib import Path

import click

from trolley.cli.init import render
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.cli.show import print_table
from trolley.config import ConfigError
from trolley.config.describe import to_toml
from trolley.config.robot_toml import check_text, replace_text
from trolley.files import read_file, write_atomically
from trolley.gridmap.description import read_description, render_description
from trolley_base.importers.linorobot.findings import Findings
from trolley_base.importers.linorobot.hardware import DRIVES, LIDARS
from trolley_base.importers.linorobot.reading import read_linorobot

DEFAULT_FOOTPRINT = {"length_m": 0.30, "width_m": 0.24}
MAPS = "maps"

Files = dict[Path, bytes]


@click.command(name="linorobot")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "-o",
    "--output",
    default="robot.toml",
    show_default=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The file to write; maps are copied beside it.",
)
@click.option("--force", is_flag=True, help="Overwrite files that are there.")
@click.option("--name", default="trolley", show_default=True, help="The robot's name.")
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
    folder: Path, output: Path, force: bool, name: str, base: str, lidar: str
) -> None:
    """Write a robot.toml from the files of a linorobot (ROS 1).

    FOLDER is its package, with launch, param and maps, or what you have of it. The files are only
    read, never run.
    """
    if not re.fullmatch(r"[a-z0-9_-]{1,32}", name):
        raise click.BadParameter("a robot's name is 1 to 32 of a-z, 0-9, _ and -")
    findings = read_linorobot(folder, base, lidar)
    if not findings.taken:
        raise click.BadParameter(
            f"{folder} holds no file of a linorobot that says anything: give the folder of the "
            f"package, with launch, param and maps, such as ~/linorobot_ws/src/linorobot",
            param_hint="FOLDER",
        )
    files = _map_files(findings, output.parent / MAPS)
    if not force:
        _refuse_to_overwrite(output, files)
    text = _text(findings, name)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        check_text(output, text)
        for path, content in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)
    except OSError as error:
        raise ConfigError(f"{error.filename}: cannot be written: {error.strerror}") from error
    replace_text(output, text)
    _report(findings, output)


def _text(findings: Findings, name: str) -> str:
    """Return the text of the robot.toml."""
    chosen = {
        "robot.footprint": to_toml(DEFAULT_FOOTPRINT),
        **findings.chosen,
        "robot.name": to_toml(name),
    }
    head = f"# Made from the linorobot files in {findings.folder}:\n"
    sources = "".join(f"#   {words}: {place}\n" for words, place in findings.taken)
    return head + sources + render(chosen)


def _map_files(findings: Findings, folder: Path) -> Files:
    """Return the map's two files as they are to lie in a folder.

    The name in the description is the image's alone: wherever it was, it is beside it now.
    """
    source = findings.map_file
    if source is None:
        return {}
    stem = re.sub(r"[^A-Za-z0-9_.-]", "_", source.stem)
    description = read_description(source)
    image = source.parent / description.image
    content = read_file(source)
    if description.image != image.name or stem != source.stem:
        image_name = f"{stem}{image.suffix}"
        content = render_description(replace(description, image=image_name)).encode("utf-8")
    else:
        image_name = image.name
    findings.set("map.file", f"{MAPS}/{stem}.yaml")
    return {folder / image_name: read_file(image), folder / f"{stem}.yaml": content}


def _refuse_to_overwrite(output: Path, files: Files) -> None:
    """Refuse if a file already exists with other content."""
    taken = [output] if output.exists() else []
    taken += [
        path for path, content in files.items() if path.exists() and read_file(path) != content
    ]
    if taken:
        raise click.UsageError(
            f"{', '.join(map(str, taken))} already exists; not overwritten. Use --force to "
            f"overwrite it, or -o for another file"
        )


def _report(findings: Findings, output: Path) -> None:
    print_table(("taken", "from"), findings.taken)
    for note in findings.notes:
        say()
        say(note)
    say()
    say(f"Wrote {output}. Next: `trolley detect --write {output}` on the robot finds the")
    say(f"ports' permanent names; then `trolley up --config {output}`.")
