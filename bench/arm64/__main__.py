"""Whether Trolley works on 64-bit ARM, the Raspberry Pi's processor, without one at hand.

    sudo make arm64 [ARGS="--tests tests/unit"]

It makes a Debian 12 for arm64 in a folder, sets the last commit up in there as `make setup` does
anywhere, and runs in it, emulated by qemu: tests, drives through the localizer, whose poses have
to be those found on x86-64 to 1 mm, and the demo's tour in lock-step. Then it prints a table; exit
code 1 if something in it is wrong. The drives are the demo's tour, recorded for the purpose, and
the real ones in the folder that TROLLEY_DATA names, if any.

The first run takes about an hour of a PC's processor, most of it to compile the kernels.
Interrupted, it goes on from the last part of the set-up that was complete, and keeps the kernels
that it has. Nothing is written outside `--folder`; delete that folder and nothing is left. An
emulator says nothing about the speed of a Pi, nor about its devices.
"""

import argparse
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.arm64.debian import CannotRun, Debian, network_environment, only_run, what_is_missing
from bench.harness.paths import ROOT, WORLDS
from bench.harness.recorded import MAPS

CHECKOUT, DRIVE = "/trolley", "/var/tmp/drive"
PYTHON = ".venv/bin/python"
TESTS = (
    "tests/unit/geometry",
    "tests/unit/gridmap",
    "tests/golden",
    "tests/process/test_zenoh_bus.py",
)
"""What is next to the processor, and takes minutes even here: arithmetic, kernels, the bytes of
messages and of saved files, and Zenoh, which is no Python."""
SAME_M, SAME_RAD = 1e-3, math.radians(0.1)
TAIL = 30
"""Lines of a step's output that are shown where it fails."""
TOUR = ("-m", "bench.stack.tour", "--seeds", "1", "--jobs", "1")

Pose = tuple[int, str, tuple[float, float, float] | None]


class StepFailed(Exception):
    """A step went wrong; the text says how."""


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    step: str
    outcome: str
    is_good: bool
    minutes: float


def read_poses(path: Path) -> list[Pose]:
    """What `bench.arm64.poses follow` wrote."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [(stamp, state, None if pose is None else tuple(pose)) for stamp, state, pose in rows]


def compare(here: Sequence[Pose], there: Sequence[Pose]) -> str:
    """How far the poses of two machines are apart, where they are the same.

    Raises:
        StepFailed: They are not.
    """
    if not here or [one[0] for one in here] != [one[0] for one in there]:
        raise StepFailed(f"{len(there)} poses, and {len(here)} on x86-64, or at other times")
    others, far_m, far_rad = 0, [0.0], [0.0]
    for (stamp_ns, state, one), (_, other_state, other) in zip(here, there, strict=True):
        others += state != other_state
        if one is not None and other is not None:
            far_m.append(math.dist(one[:2], other[:2]))
            far_rad.append(abs(math.remainder(one[2] - other[2], math.tau)))
        elif one is not other:
            raise StepFailed(f"at {stamp_ns * 1e-9:.1f} s there is a pose on one of them only")
    said = (
        f"{len(here)} poses, at most {max(far_m) * 1e3:.2g} mm and "
        f"{math.degrees(max(far_rad)):.2g}° from those on x86-64; {others} other states"
    )
    # Each by itself: a maximum overlooks what is not a number.
    is_near = all(one <= SAME_M for one in far_m) and all(one <= SAME_RAD for one in far_rad)
    if not is_near or others:
        raise StepFailed(said)
    return said


class Trial:
    """The steps, one after the other; each adds a row.

    Args:
        debian: where the emulated part runs.
        scratch: a folder for the part that runs here.
    """

    def __init__(self, debian: Debian, scratch: Path) -> None:
        """Nothing was tried yet."""
        self.rows: list[Row] = []
        self._debian = debian
        self._scratch = scratch

    def step(self, name: str, act: Callable[[], str]) -> bool:
        """Do a step; whether it went well."""
        print(f"{time.strftime('%H:%M')}  {name} ...", flush=True)
        began_s = time.monotonic()
        try:
            outcome, is_good = act(), True
        except StepFailed as failure:
            outcome, is_good = str(failure), False
            print(outcome, flush=True)
        minutes = (time.monotonic() - began_s) / 60.0
        self.rows.append(Row(name, outcome.splitlines()[0], is_good, minutes))
        return is_good

    def make_root(self, mirror: str | None) -> str:
        """Debian itself."""
        try:
            is_new = self._debian.make(mirror)
        except subprocess.CalledProcessError as error:
            raise StepFailed(_failure("debootstrap", error.returncode, self._log("root"))) from None
        return "made with debootstrap" if is_new else "there already"

    def set_up(self) -> str:
        """The last commit, installed as anywhere."""
        commit = self._check_out()
        self._debian.use_network()
        # Nobody imports most of it: bytecode of it all would take the emulator minutes.
        self._run("set-up", ["make", "setup", "COMPILE_BYTECODE="], network_environment())
        checkout = self._inside(CHECKOUT)
        packages = list(checkout.glob(".venv/lib/python3*/site-packages/*.dist-info"))
        # Code of a kernel for each kind of arguments.
        kernels = list(checkout.glob("[cs]*/**/__pycache__/*.nbc"))
        compiler = "import llvmlite.binding as llvm; print(llvm.get_host_cpu_name())"
        processor = self._run("processor", [PYTHON, "-c", compiler]).read_text().strip()
        return (
            f"commit {commit}: {len(packages)} packages, {len(kernels)} compiled kernels for "
            f"{processor}"
        )

    def test(self, tests: Sequence[str]) -> str:
        """Run pytest; its summary."""
        log = self._run(
            "tests", [PYTHON, "-m", "pytest", "-q", "--color=no", "-p", "no:cacheprovider", *tests]
        )
        return log.read_text().rstrip().splitlines()[-1]

    def drive(self, drive: Path, map_file: Path) -> str:
        """Follow a drive here and there, and compare the poses."""
        if not drive.exists():
            raise StepFailed(f"{drive} is not there; does TROLLEY_DATA name the right folder?")
        folder, here = self._inside(DRIVE), self._scratch / "poses"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for one in (drive, *map_file.parent.glob(f"{map_file.stem}.*")):
            shutil.copy(one, folder)
        follow = ("-m", "bench.arm64.poses", "follow")
        self._run_here([*follow, *map(str, (drive, map_file, here))])
        given = (f"{DRIVE}/{name}" for name in (drive.name, map_file.name, here.name))
        self._run("drive", [PYTHON, *follow, *given])
        return compare(read_poses(here), read_poses(folder / here.name))

    def record_tour(self) -> Path:
        """The demo's tour, driven and recorded here."""
        path = self._scratch / "tour.mcap"
        self._run_here(["-m", "bench.arm64.poses", "record", str(path)])
        return path

    def tour(self) -> str:
        """The demo's tour in lock-step, here and there."""
        here = self._run_here(TOUR).splitlines()[0]
        there = self._run("tour", [PYTHON, *TOUR]).read_text().splitlines()[0]
        if "1 of 1 arrived, 0 collisions, 0 hung" not in self._log("tour").read_text():
            raise StepFailed(there)
        return f"{there.strip()} ({'the same as' if here == there else 'otherwise'} on x86-64)"

    def _check_out(self) -> str:
        """Put the last commit there; what was compiled before stays. The commit."""
        commit = _git("rev-parse", "--short", "HEAD").decode().strip()
        changed = _git("status", "--porcelain").splitlines()
        if changed:
            print(f"       {len(changed)} files that are not committed are not tried", flush=True)
        checkout = self._inside(CHECKOUT)
        checkout.mkdir(exist_ok=True)
        remove_sources(checkout)
        subprocess.run(
            ["tar", "-x", "-C", str(checkout)], input=_git("archive", "HEAD"), check=True
        )
        return commit

    def _run(
        self, step: str, command: Sequence[str], environment: dict[str, str] | None = None
    ) -> Path:
        """Run something in the checkout there; the log of what it said.

        Raises:
            StepFailed: It failed.
        """
        log = self._log(step)
        code = self._debian.run(command, log, {"CI": "1", **(environment or {})}, CHECKOUT)
        if code != 0:
            raise StepFailed(_failure(" ".join(command[:4]), code, log))
        return log

    def _run_here(self, arguments: Sequence[str]) -> str:
        """Run a Python program of this checkout, which leaves no files in it; what it printed.

        Raises:
            StepFailed: It failed.
        """
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            [sys.executable, *arguments], cwd=ROOT, env=environment,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            raise StepFailed(f"on x86-64, {' '.join(arguments)} failed:\n{done.stdout}")
        return done.stdout

    def _log(self, step: str) -> Path:
        return self._debian.log_of(step)

    def _inside(self, path: str) -> Path:
        return self._debian.path / path.lstrip("/")


def _git(*words: str) -> bytes:
    """What git says of this clone, whoever owns it.

    Raises:
        StepFailed: It is no clone.
    """
    command = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT), *words]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode != 0:
        raise StepFailed(f"git {words[0]} failed: {done.stderr.decode().strip()}")
    return done.stdout


def _failure(command: str, code: int, log: Path) -> str:
    """What to say of a program that failed."""
    lines = log.read_text(errors="replace").splitlines()[-TAIL:]
    return "\n  ".join([f"{command} ended with exit code {code}; its output: {log}", *lines])


def remove_sources(checkout: Path) -> None:
    """Remove all but what was installed and compiled."""
    for folder, names, files in os.walk(checkout):
        names[:] = [name for name in names if name not in (".venv", "__pycache__")]
        for name in files:
            (Path(folder) / name).unlink()


def recorded_drives() -> list[tuple[Path, Path]]:
    """The drives in the folder that TROLLEY_DATA names, and their maps."""
    folder = os.environ.get("TROLLEY_DATA")
    if folder is None:
        return []
    return [(Path(folder) / f"{name}.npz", Path(folder) / one) for name, one in MAPS.items()]


def try_all(trial: Trial, mirror: str | None, tests: Sequence[str]) -> None:
    """Run all steps; without a root or a set-up there is nothing to run the others in."""
    if not trial.step("Debian 12, arm64", lambda: trial.make_root(mirror)):
        return
    if not trial.step("make setup", trial.set_up):
        return
    trial.step("tests", lambda: trial.test(tests))
    trial.step(
        "recorded tour of the demo",
        lambda: trial.drive(trial.record_tour(), WORLDS / "apartment.yaml"),
    )
    for drive, map_file in recorded_drives():
        trial.step(drive.stem, lambda one=drive, other=map_file: trial.drive(one, other))
    trial.step("the demo's tour in lock-step", trial.tour)


def main() -> None:
    """Try it, and print the table."""
    parser = argparse.ArgumentParser(
        prog="make arm64", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path.home() / ".cache/trolley/arm64",
        help="where the root is kept [default: ~/.cache/trolley/arm64]",
    )
    parser.add_argument("--mirror", help="of Debian [default: the one that apt uses here]")
    parser.add_argument(
        "--tests",
        nargs="+",
        default=TESTS,
        metavar="PATH",
        help=f"for pytest [default: {' '.join(TESTS)}]",
    )
    options = parser.parse_args()
    # As Ctrl-C does, so that what runs in the root is ended as well.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("Ended; run it again to go on."))
    folder = options.folder.absolute()
    missing = what_is_missing(folder)
    if missing:
        sys.exit("\n".join(["This machine cannot try arm64:", *(f"- {one}" for one in missing)]))
    try:
        with only_run(folder), tempfile.TemporaryDirectory() as scratch:
            trial = Trial(Debian(folder), Path(scratch))
            try_all(trial, options.mirror, options.tests)
    except CannotRun as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit("\nInterrupted; run it again to go on.")
    width = max(len(one.step) for one in trial.rows)
    for one in trial.rows:
        verdict = "good" if one.is_good else "WRONG"
        print(f"{one.step:{width}}  {one.minutes:5.1f} min  {verdict:5}  {one.outcome}")
    sys.exit(not all(one.is_good for one in trial.rows))


if __name__ == "__main__":
    main()
