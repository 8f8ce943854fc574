"""`trolley import`: what other systems' files say; its commands come with the services."""

import click

from trolley.cli import PluggedGroup


@click.group(name="import", cls=PluggedGroup)
def import_command() -> None:
    """Import settings or drives from another system."""
