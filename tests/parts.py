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


class Found(NamedTuple):
    """What a part found, line by line."""

    failed: Sequence[str]
    """What failed in the end."""
    again: Sequence[str] = ()
    """Which tests passed only when they were run again, why they may be, and how they failed."""


def lint(output: IO[str] | None) -> Found:
    """Run ruff, its formatter and pyrefly."""
    tools = {
        "ruff check .": ["ruff", "check", "."],
        "ruff format --check .": ["ruff", "format", "--check", "."],
        "pyrefly check": ["pyrefly", "check"],
    }
    folder = Path(sys.executable).parent
    return Found(
        [
            f"{name} has found something"
            for name, (program, *arguments) in tools.items()
            if run([str(folder / program), *arguments], output) != 0
        ]
    )


def tests(name: str, marks: str, output: IO[str] | None) -> Found:
    """Run the tests of a part."""
    part, report = PARTS[name], REPORTS / f"{name}.xml"
    report.unlink(missing_ok=True)
    choice = ("-m", part.marks or marks, f"--junitxml={report}")
    code = run([*part.before, *PYTEST, *choice, *part.arguments], output)
    every = ElementTree.parse(report).iter("testcase") if report.exists() else ()
    cases = {name_of(case): case for case in every}.values()  # the last run of each counts
    failed = [line for case in cases if (line := failure_of(case))]
    if code not in (0, 1, NO_TESTS) or (code == 1 and not failed):
        failed.append(f"pytest ended with exit code {code}; see above")
    return Found(failed, [line for case in cases for line in runs_before(case)])


def failure_of(case: ElementTree.Element) -> str:
    """Return a test that failed or could not begin, as pytest takes it on its command line."""
    problem = next((one for one in case if one.tag in ("failure", "error")), None)
    if problem is None:
        return ""
    line = (problem.get("message") or "").partition("\n")[0]
    return f"{name_of(case)}  {line[:100]}"


def runs_before(case: ElementTree.Element) -> Iterator[str]:
    """Yield how a test failed before it passed."""
    if failure_of(case):
        return
    said = [(one.get("name"), one.get("value") or "") for one in case.iter("property")]
    for name, value in said:
        if name == "failed":
            problem = next((line for line in value.splitlines() if line.startswith("E ")), "")
            yield f"{name_of(case)}  {dict(said)['why_again']}: {problem[1:].strip()[:100]}"


def name_of(case: ElementTree.Element) -> str:
    """Return the name of a test, as pytest takes it on its command line."""
    return f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"


def run(command: Sequence[str], output: IO[str] | None) -> int:
    """Run a command, its words into a file or as they come; the exit code."""
    return subprocess.run(
        command, cwd=ROOT, stdout=output, stderr=output and subprocess.STDOUT, check=False
    ).returncode


class Check:
    """What the parts found and how long they took, in whatever order they end."""

    def __init__(self, marks: str) -> None:
        self._found: dict[str, Found] = {}
        self._marks = marks
        self._took_s: dict[str, float] = {}

    def run(self, part: str, output: IO[str] | None = None) -> None:
        """Run one part."""
        began_s = time.monotonic()
        found = lint(output) if part == "lint" else tests(part, self._marks, output)
        self._found[part], self._took_s[part] = found, time.monotonic() - began_s

    @property
    def has_failed(self) -> bool:
        """Whether anything failed in the end."""
        return any(found.failed for found in self._found.values())

    def run_beside(self, parts: Sequence[str]) -> None:
        """Run parts one after another; print what each said when it is done."""
        for part in parts:
            with tempfile.TemporaryFile("w+") as output:
                self.run(part, output)
                output.seek(0)
                print(f"\n== {part}\n{output.read()}", flush=True)

    def summary(self) -> str:
        """Name what failed, and what had to be run again, part by part."""
        return "\n".join(
            f"{part:8} {self._took_s[part]:4.0f} s  {len(found.failed) or 'nothing'} failed"
            + "".join(f"\n    {line}" for line in found.failed)
            + "".join(f"\n    run again: {line}" for line in found.again)
            for part, found in self._found.items()
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
    return check.has_failed


if __name__ == "__main__":
    raise SystemExit(main())
