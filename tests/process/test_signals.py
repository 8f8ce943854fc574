"""Whatever shell the tests are started from: their children begin with default signals."""

import re
import signal
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PROGRAM = f"""
import subprocess, sys
sys.path.insert(0, {str(TESTS)!r})
if sys.argv[1] == "defaults":
    from support.signals import start_children_with_defaults
    start_children_with_defaults()
print(subprocess.check_output(["cat", "/proc/self/status"], text=True))
"""
STOPPED = "trap '' INT HUP; exec \"$@\""
"""What a shell does to what it starts in its background, and `nohup`."""
USABLE = sum(1 << (number - 1) for number in signal.valid_signals())
"""Signals that programs may use, as bits; the C library keeps two more to itself (32 and 33)."""


def ignored_and_blocked(how: str) -> int:
    """The signals that a child of the program does not get, as bits."""
    command = ["sh", "-c", STOPPED, "sh", sys.executable, "-c", PROGRAM, how]
    status = subprocess.check_output(command, text=True)
    masks = dict(re.findall(r"(Sig(?:Ign|Blk)):\s*(\w+)", status))
    return (int(masks["SigIgn"], 16) | int(masks["SigBlk"], 16)) & USABLE


def test_children_begin_with_default_signals() -> None:
    both = 1 << (signal.SIGINT - 1) | 1 << (signal.SIGHUP - 1)
    assert ignored_and_blocked("as they are") & both == both
    assert ignored_and_blocked("defaults") == 0
