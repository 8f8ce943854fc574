"""What the exit codes of `trolley` mean."""

OK = 0
FAILED = 1
USAGE = 2
UNREACHABLE = 3
INTERRUPTED = 130

MEANINGS = {
    OK: "done",
    FAILED: "the robot refused or failed; the code and a sentence say why",
    USAGE: "wrong command or configuration, or several robots were found and none was named",
    UNREACHABLE: "no router, no such robot, or the service that answers is not running",
    INTERRUPTED: "interrupted (Ctrl-C)",
}
"""By code; `docs/command-line.md` and `trolley --help` print this table."""
