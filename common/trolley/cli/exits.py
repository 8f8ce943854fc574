"""What the exit codes of `trolley` mean."""

from trolley import start

OK = 0
FAILED = 1
USAGE = 2
UNREACHABLE = 3
HUNG_UP = 129
INTERRUPTED = start.INTERRUPTED

MEANINGS = {
    OK: "done",
    FAILED: "the robot refused or failed; the code and a sentence say why",
    USAGE: "wrong command or configuration, or several robots were found and none was named",
    UNREACHABLE: "no router, no such robot, or the service that answers is not running",
    HUNG_UP: "the terminal was closed",
    INTERRUPTED: "interrupted (Ctrl-C)",
}
"""By code; `docs/command-line.md` and `trolley --help` print this table."""
