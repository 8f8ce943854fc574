"""How commands print: the one place where text goes to a terminal or a pipe.

What is printed may come from a stranger, so nothing but the colours asked for here moves the
terminal (see `trolley.sanitize`), and a terminal that lacks a letter gets another in its place.
"""

import errno
import io
import sys

import click

from trolley.cli import exits
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
    r"""Print a line of text, in a colour or bold where the terminal has them.

    A text from outside cannot begin a line of its own: the ends of lines in it are shown as `\n`.

    Args:
        text: what to print.
        err: to stderr instead of stdout.
        nl: whether the line ends.
        fg: the colour.
        bg: the colour behind it.
        bold: whether it is bold.
    """
    stream = sys.stderr if err else sys.stdout
    fitting = fit(escape(text, "\t"), stream.encoding)
    styled = click.style(fitting, fg=fg, bg=bg, bold=bold) if fg or bg or bold else fitting
    _echo(styled, err=err, nl=nl)


def say_block(text: str, *, err: bool = False, nl: bool = True, fg: str | None = None) -> None:
    """Print lines of text of Trolley's own making; those from outside in it must be escaped.

    Args:
        text: what to print.
        err: to stderr instead of stdout.
        nl: whether the last line is ended.
        fg: the colour.
    """
    for number, line in enumerate(text.removesuffix("\n").split("\n")):
        if number:
            _echo(err=err)
        say(line, err=err, nl=False, fg=fg)
    if nl or text.endswith("\n"):
        _echo(err=err)


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


def _echo(text: str = "", *, err: bool, nl: bool = True) -> None:
    """Write to a stream.

    Raises:
        SystemExit: What is written to stdout finds no room, as in a file on a full disk.
    """
    try:
        click.echo(text, err=err, nl=nl)
    except OSError as error:
        if err or error.errno == errno.EPIPE:  # a reader that has enough is no failure
            raise
        _echo(f"The output cannot be written: {error.strerror}.", err=True)
        raise SystemExit(exits.FAILED) from error


def show_error(error: click.ClickException) -> None:
    """Print why a command cannot be carried out."""
    words = io.StringIO()
    error.show(words)
    say_block(words.getvalue(), err=True, nl=False)
