"""Run all parts of the check, whatever fails, and list at the end what did.

The tests that compute keep the processor busy. Beside them, and before them where both want it,
run the parts that mostly wait for other programs; what those print comes when they are done.

python tests/parts.py "not slow"        as `make test`
python tests/parts.py slow              as `make slow`
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, NamedTuple
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "out" / "tests"
PYTEST = [sys.executable, "-m", "pytest"]
# Each worker collects all tests of its part, which takes it ten seconds of a core. One more than
# there are cores keeps them busy while a test waits, which some do for a fifth of their time.
# Tests of whole processes wait most of the time, so three of them run side by side. A browser that
# renders in software, and a robot that drives for it, take a core: there is one of those.
CORES = os.cpu_count() or 1
COMPUTE = ("--ignore=tests/process", "--ignore=tests/browser")


class Part(NamedTuple):
    """Some of the tests."""

    arguments: Sequence[str]
    """Of pytest."""
    before: Sequence[str] = ()
    """What its command begins with."""
    marks: str = ""
    """Which tests whatever is asked for, if any."""


PARTS = {
    "compute": Part(
        ("--numprocesses", str(CORES + 1), "--dist", "worksteal", *COMPUTE), ("nice", "-n", "5")
    ),
    "process": Part(("--numprocesses", "3", "--dist", "worksteal", "tests/process")),
    "browser": Part(("tests/browser",)),
    # Properties that are not slow, on cases that nobody has seen.
    "new": Part(COMPUTE, ("env", "TROLLEY_NEW_CASES=1"), "hypothesis and not slow"),
}
BESIDE = {
    "not slow": (("browser",), ("lint", "process")),
    "slow": (("browser",), ("process", "new")),
}
"""What is run beside the tests that compute; the parts of a row one after another."""
NO_TESTS = 5
"""What pytest returns where all were deselected."""


def lint(output: IO[str] | None) -> list[str]:
    """Run ruff, its formatter and pyrefly; return what they complained of."""
    tools = {
        "ruff check .": ["ruff", "check", "."],
        "ruff format --check .": ["ruff", "format", "--check", "."],
        "pyrefly check": ["pyrefly", "check"],
    }
    folder = Path(sys.executable).parent
    return [
        f"{name} has found something"
        for name, (program, *arguments) in tools.items()
        if run([str(folder / program), *arguments], output) != 0
    ]


def tests(name: str, marks: str, output: IO[str] | None) -> list[str]:
    """Run the tests of a part; return those that failed."""
    part, report = PARTS[name], REPORTS / f"{name}.xml"
    report.unlink(missing_ok=True)
    choice = ("-m", part.marks or marks, f"--junitxml={report}")
    code = run([*part.before, *PYTEST, *choice, *part.arguments], output)
    found = list(failures(report)) if report.exists() else []
    if code not in (0, 1, NO_TESTS) or (code == 1 and not found):
        found.append(f"pytest ended with exit code {code}; see above")
    return found


def failures(report: Path) -> Iterator[str]:
    """Yield the tests that failed or could not begin, as pytest takes them on its command line."""
    for case in ElementTree.parse(report).iter("testcase"):
        problem = next(
            (case.find(kind) for kind in ("failure", "error") if case.find(kind) is not None), None
        )
        if problem is not None:
            path = f"{case.get('classname', '').replace('.', '/')}.py"
            line = (problem.get("message") or "").partition("\n")[0]
            yield f"{path}::{case.get('name')}  {line[:100]}"


def run(command: Sequence[str], output: IO[str] | None) -> int:
    """Run a command, its words into a file or as they come; the exit code."""
    return subprocess.run(
        command, cwd=ROOT, stdout=output, stderr=output and subprocess.STDOUT, check=False
    ).returncode


class Check:
    """What the parts found and how long they took, in whatever order they end."""

    def __init__(self, marks: str) -> None:
        self.failed: dict[str, list[str]] = {}
        self._marks = marks
        self._took_s: dict[str, float] = {}

    def run(self, part: str, output: IO[str] | None = None) -> None:
        """Run one part."""
        began_s = time.monotonic()
        found = lint(output) if part == "lint" else tests(part, self._marks, output)
        self.failed[part], self._took_s[part] = found, time.monotonic() - began_s

    def run_beside(self, parts: Sequence[str]) -> None:
        """Run parts one after another; print what each said when it is done."""
        for part in parts:
            with tempfile.TemporaryFile("w+") as output:
                self.run(part, output)
                output.seek(0)
                print(f"\n== {part}\n{output.read()}", flush=True)

    def summary(self) -> str:
        """Name what failed, part by part."""
        return "\n".join(
            f"{part:8} {self._took_s[part]:4.0f} s  {len(found) or 'nothing'} failed"
            + "".join(f"\n    {line}" for line in found)
            for part, found in self.failed.items()
        )


def main() -> int:
    """Run all parts; the exit code."""
    marks = sys.argv[1]
    REPORTS.mkdir(parents=True, exist_ok=True)
    check = Check(marks)
    began_s = time.monotonic()
    rows = BESIDE[marks]
    with ThreadPoolExecutor(len(rows)) as pool:
        done = [pool.submit(check.run_beside, row) for row in rows]
        print("\n== compute", flush=True)
        check.run("compute")
        for one in done:
            one.result()
    took_s = time.monotonic() - began_s
    print(f"\n== all parts\n{check.summary()}\nall      {took_s:4.0f} s, {CORES} cores")
    return any(check.failed.values())


if __name__ == "__main__":
    raise SystemExit(main())
