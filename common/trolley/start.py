"""Where Trolley's programs start, before anything slow is imported.

Python turns Ctrl-C into an exception wherever it happens to be, and in the middle of an import that
is a page of useless traceback. Until a program has something to tidy up, Ctrl-C simply ends it,
like any other program: by the signal itself, without a message. This module imports only what
Python has already loaded, so that hardly any time passes before that.
"""

import os
import signal
import sys

INTERRUPTED = 130
"""Exit code that shells use for the end by Ctrl-C."""


def command() -> None:
    """Run the command line."""
    _open_closed_streams()
    try:
        with EndingAtOnce():
            from importlib import import_module

            main = import_module("trolley.cli").main
        main()
    except KeyboardInterrupt:
        leave("interrupted\n", INTERRUPTED)
    finally:
        _end_at_once()  # there is nothing left to tidy up


def program(*words: str) -> list[str]:
    """The command that runs one of our modules as a program of its own.

    `-P` leaves out the current folder, where a file of the user's may be called as a module is:
    Python would run their `queue.py`, or the `trolley.py` that drives their robot, in its place.

    Args:
        words: the module, and its arguments.
    """
    return [sys.executable, "-P", "-m", *words]


def service(module: str, name: str) -> None:
    """Run a service as this process.

    Args:
        module: where it is.
        name: its class, or what makes one of a configuration.
    """
    _end_at_once()  # its process knows itself when it has something to tidy up
    from importlib import import_module

    main = import_module("trolley.runtime.process").main
    main(getattr(import_module(module), name))


def leave(words: str, code: int) -> None:
    """End at once: what was begun has been ended, and a library may be caught in the middle."""
    _end_at_once()
    try:
        sys.stdout.flush()
        sys.stderr.write(words)
        sys.stderr.flush()
    except (OSError, ValueError):
        pass  # the terminal is gone, or closed already
    finally:
        os._exit(code)


class EndingAtOnce:
    """Lets Ctrl-C end the program by itself meanwhile, as while modules are imported."""

    def __enter__(self) -> None:
        self._before = signal.getsignal(signal.SIGINT)
        _end_at_once()

    def __exit__(self, *_: object) -> None:
        if signal.getsignal(signal.SIGINT) is not self._before:
            signal.signal(signal.SIGINT, self._before)


def _open_closed_streams() -> None:
    """Let what goes to a closed stream (`>&-`) go nowhere, and not into what is opened next."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            # The lowest number that is free, which is this one; services inherit it.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, os.fdopen(number, mode))


def _end_at_once() -> None:
    """Let SIGINT end the program, unless it is ignored as in a shell's background."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
