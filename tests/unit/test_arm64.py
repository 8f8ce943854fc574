"""What `make arm64` decides by itself, and that it leaves nothing mounted or running."""

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bench.arm64.__main__ import Pose, StepFailed, compare, remove_sources
from bench.arm64.debian import (
    CannotRun,
    emulator_problem,
    mirror_of,
    only_run,
    pip_environment,
)
from support.waiting import wait_until

ROOT = Path(__file__).resolve().parents[2]
SOURCES = """\
https://packages.example.org/apt cloud cloud
http://mirror.example.org/debian-security/ Debian Debian-Security
http://mirror.example.org/debian/ Debian Debian
"""
STOOD: Pose = (100, "localized", (1.0, 2.0, math.pi))

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root")


def moved(x: float = 0.0, turn: float = 0.0, state: str = "localized") -> Pose:
    return (100, state, (1.0 + x, 2.0, math.pi + turn))


def test_the_mirror_is_the_one_of_debian_itself() -> None:
    assert mirror_of(SOURCES) == "http://mirror.example.org/debian/"


@pytest.mark.parametrize("sources", ["", SOURCES.replace(" Debian Debian\n", " Ubuntu Ubuntu\n")])
def test_without_a_mirror_of_debian_it_says_how_to_name_one(sources: str) -> None:
    with pytest.raises(CannotRun, match="--mirror"):
        mirror_of(sources)


def test_pips_way_to_the_packages_goes_along_and_this_machines_folders_do_not() -> None:
    settings = [
        "global.index-url='https://packages.example.org/simple'",
        "global.extra-index-url='file:///opt/simple https://more.example.org/simple'",
        "global.find-links='/opt/wheels'",
        "global.constraint='/etc/constraints.txt'",
        ":env:.default-timeout='180'",
        ":env:.cert='/etc/ssl/own.crt'",
    ]
    assert pip_environment(settings) == {
        "PIP_INDEX_URL": "https://packages.example.org/simple",
        "PIP_EXTRA_INDEX_URL": "https://more.example.org/simple",
        "PIP_DEFAULT_TIMEOUT": "180",
    }


@pytest.mark.parametrize(
    ("entry", "word"),
    [
        (None, "apt install"),
        ("disabled\ninterpreter /usr/bin/qemu-aarch64-static\nflags: F\n", "switched off"),
        ("enabled\ninterpreter /usr/bin/qemu-aarch64-static\nflags: P\n", "flag F"),
    ],
)
def test_an_emulator_that_would_not_run_is_told(
    tmp_path: Path, entry: str | None, word: str
) -> None:
    path = tmp_path / "qemu-aarch64"
    if entry is not None:
        path.write_text(entry)
    assert word in (emulator_problem(path) or "")


def test_an_emulator_that_runs_is_no_problem(tmp_path: Path) -> None:
    path = tmp_path / "qemu-aarch64"
    path.write_text("enabled\ninterpreter /usr/libexec/aarch64-binfmt-P\nflags: POCF\n")
    assert emulator_problem(path) is None


def test_poses_within_a_millimetre_are_the_same() -> None:
    assert "0.5 mm" in compare([STOOD], [moved(x=5e-4)])
    # One just below, one just above the turn by half a circle.
    turned: Pose = (100, "localized", (1.0, 2.0, 1e-4 - math.pi))
    assert "0.0057°" in compare([STOOD], [turned])


@pytest.mark.parametrize(
    "other",
    [
        [],
        [(101, *STOOD[1:])],
        [moved(x=2e-3)],
        [moved(x=math.nan)],
        [moved(turn=0.01)],
        [moved(state="unsure")],
        [(100, "lost", None)],
        [STOOD, STOOD],
    ],
)
def test_other_poses_are_not_the_same(other: list[Pose]) -> None:
    with pytest.raises(StepFailed):
        compare([STOOD], other)


def test_no_poses_are_not_the_same() -> None:
    with pytest.raises(StepFailed):
        compare([], [])


def test_a_new_checkout_keeps_what_was_installed_and_compiled_only(tmp_path: Path) -> None:
    kept = ("common/__pycache__/kernel.nbc", ".venv/bin/python")
    for name in (*kept, "common/old.py", "Makefile"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    remove_sources(tmp_path)
    files = [one for one in tmp_path.rglob("*") if one.is_file()]
    assert sorted(str(one.relative_to(tmp_path)) for one in files) == sorted(kept)


def test_two_runs_do_not_share_a_root(tmp_path: Path) -> None:
    with only_run(tmp_path), pytest.raises(CannotRun, match="Another run"), only_run(tmp_path):
        pass
    with only_run(tmp_path):
        pass


# Runs a command in a root, which is this system's own: what matters is what stays of it.
RUN = """
import sys
from pathlib import Path
from bench.arm64.debian import Debian
folder = Path(sys.argv[1])
(folder / "root").symlink_to("/")
inside = "mount -t tmpfs none /mnt && touch /mnt/$$ && echo mounted && exec sleep 1234567"
Debian(folder).run(["bash", "-c", inside], folder / "log", {}, "/")
"""


def sleeping() -> bool:
    """Whether the program in the root still runs."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if path.read_bytes() == b"sleep\x001234567\x00":
                return True
        except OSError:
            pass  # it has just ended
    return False


@needs_root
@pytest.mark.programs
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_nothing_stays_mounted_or_running_however_it_ends(
    tmp_path: Path, signal_number: signal.Signals
) -> None:
    before = Path("/proc/mounts").read_text()
    log = tmp_path / "log"
    runner = subprocess.Popen([sys.executable, "-c", RUN, str(tmp_path)], cwd=ROOT)
    wait_until(lambda: log.exists() and "mounted" in log.read_text(), "it is mounted")
    assert Path("/proc/mounts").read_text() == before
    runner.send_signal(signal_number)
    runner.wait()
    wait_until(lambda: not sleeping(), "what it started is gone")
    assert Path("/proc/mounts").read_text() == before
