"""How commands print: the one place where text goes to a terminal or a pipe.

What is printed may come from a stranger, so nothing but the colours asked for here moves the
terminal (see `trolley.sanitize`), and a terminal that lacks a letter gets another in its place.
"""

import io
import sys

import click

from trolley.sanitize import escape, fit


def say(
    text: str = "",
    *,
    err: bool = False,
    nl: bool = True,
    fg: str | None = None,
    bg: str | None = None,
    bold: bool | None = None,
) -> None:
    """Print lines of text, in a colour or bold where the terminal has them.

    Args:
        text: what to print.
        err: to stderr instead of stdout.
        nl: whether the line ends.
        fg: the colour.
        bg: the colour behind it.
        bold: whether it is bold.
    """
    stream = sys.stderr if err else sys.stdout
    fitting = fit(text, stream.encoding)
    styled = click.style(fitting, fg=fg, bg=bg, bold=bold) if fg or bg or bold else fitting
    click.echo(styled, err=err, nl=nl)


def say_over(text: str) -> None:
    """Print a line to stderr over the one that stands there, and stay on it."""
    click.echo("\r" + fit(escape(text), sys.stderr.encoding), nl=False, err=True)


def can_say(text: str) -> bool:
    """Whether stdout has all letters of a text."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


def show_error(error: click.ClickException) -> None:
    """Print why a command cannot be carried out."""
    words = io.StringIO()
    error.show(words)
    say(words.getvalue(), err=True, nl=False)
