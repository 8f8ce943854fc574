"""`trolley import` and `export`: other systems' files; the commands come with the services."""

import click

from trolley.cli import PluggedGroup


@click.group(name="import", cls=PluggedGroup)
def import_command() -> None:
    """Import settings or drives from another system."""


@click.group(name="export", cls=PluggedGroup)
def export_command() -> None:
    """Export drives to another system."""
