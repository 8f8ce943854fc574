"""`trolley completion`."""

import click
from click.shell_completion import get_completion_class

from trolley.cli.printing import say_block


@click.command(name="completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion_command(ctx: click.Context, shell: str) -> None:
    """Print the script that completes commands in SHELL.

    \b
    bash: trolley completion bash > ~/.local/share/bash-completion/completions/trolley
    zsh:  trolley completion zsh > a folder of $fpath, as _trolley
    fish: trolley completion fish > ~/.config/fish/completions/trolley.fish
    """  # noqa: D301 (click wants the character \b itself)
    kind = get_completion_class(shell)
    assert kind is not None
    say_block(kind(ctx.find_root().command, {}, "trolley", "_TROLLEY_COMPLETE").source())
