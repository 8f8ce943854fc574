"""What the commands of `trolley import` share: writing what was found, and saying what was not."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from trolley.cli.init import render
from trolley.cli.options import json_option, robot_name_option
from trolley.cli.printing import say
from trolley.cli.show import print_json, print_table
from trolley.config import ConfigError
from trolley.config.describe import to_toml
from trolley.config.robot_toml import check_text, replace_text
from trolley.files import read_file, write_atomically
from trolley.gridmap.description import read_description, render_description
from trolley_base.importers.findings import Findings

DEFAULT_FOOTPRINT = {"length_m": 0.30, "width_m": 0.24}
MAPS = "maps"

F = TypeVar("F", bound=Callable[..., Any])
Files = dict[Path, bytes]


def output_options(command: F) -> F:
    """Add `--output`, `--force`, `--name` and `--json`."""
    options = [
        click.option(
            "-o",
            "--output",
            default="robot.toml",
            show_default=True,
            type=click.Path(dir_okay=False, path_type=Path),
            help="The file to write; maps are copied beside it.",
        ),
        click.option("--force", is_flag=True, help="Overwrite files that are there."),
        click.option(
            "--name",
            default="trolley",
            show_default=True,
            callback=robot_name_option,
            help="The robot's name.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return json_option(command)


def write_settings(
    findings: Findings, output: Path, name: str, *, force: bool, as_json: bool
) -> None:
    """Write a robot.toml and its map, and say what was taken and what was not.

    Raises:
        UsageError: A file is there already and `force` is not given.
        ConfigError: A file cannot be written, or what was found makes no robot.
    """
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
    if as_json:
        print_json(
            {
                "file": str(output),
                "taken": [{"what": what, "from": place} for what, place in findings.taken],
                "left": [{"what": what, "why": why} for what, why in findings.left],
                "notes": findings.notes,
            }
        )
    else:
        _report(findings, output)


def _text(findings: Findings, name: str) -> str:
    """Return the text of the robot.toml."""
    chosen = {
        "robot.footprint": to_toml(DEFAULT_FOOTPRINT),
        **findings.chosen,
        "robot.name": to_toml(name),
    }
    head = f"# Made from the files in {findings.folder}:\n"
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
    if findings.left:
        say()
        print_table(("not taken", "because"), findings.left)
    for note in findings.notes:
        say()
        say(note)
    say()
    say(f"Wrote {output}. Next: `trolley detect --write {output}` on the robot finds the")
    say(f"ports' permanent names; then `trolley up --config {output}`.")
