"""Run the parts of the check one after another, all of them, and list at the end what failed.

python tests/parts.py "not slow"        as `make test`
python tests/parts.py slow              as `make slow`
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "out" / "tests"
PYTEST = [sys.executable, "-m", "pytest"]
# Tests of whole processes wait most of the time, so three of them run side by side. A browser that
# renders in software takes more, so there are two of those.
PARTS: dict[str, Sequence[str]] = {
    "compute": (
        *("--numprocesses", "auto", "--dist", "worksteal"),
        *("--ignore=tests/process", "--ignore=tests/browser"),
    ),
    "process": ("--numprocesses", "3", "--dist", "worksteal", "tests/process"),
    "browser": ("--numprocesses", "2", "--dist", "loadfile", "tests/browser"),
}
NO_TESTS = 5
"""What pytest returns where all were deselected."""


def lint() -> list[str]:
    """Run ruff, its formatter and pyright; return what they complained of."""
    tools = {
        "ruff check .": ["ruff", "check", "."],
        "ruff format --check .": ["ruff", "format", "--check", "."],
        "pyright": ["pyright"],
    }
    folder = Path(sys.executable).parent
    return [
        f"{name} has found something"
        for name, (program, *arguments) in tools.items()
        if run([str(folder / program), *arguments]) != 0
    ]


def tests(part: str, marks: str) -> list[str]:
    """Run the tests of a part; return those that failed."""
    report = REPORTS / f"{part}.xml"
    report.unlink(missing_ok=True)
    code = run([*PYTEST, "-m", marks, f"--junitxml={report}", *PARTS[part]])
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


def run(command: Sequence[str]) -> int:
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def main() -> int:
    """Run all parts; the exit code."""
    marks = sys.argv[1]
    REPORTS.mkdir(parents=True, exist_ok=True)
    failed: dict[str, list[str]] = {}
    took_s: dict[str, float] = {}
    for part in ([] if marks == "slow" else ["lint"]) + [*PARTS]:
        print(f"\n== {part}", flush=True)
        began_s = time.monotonic()
        failed[part] = lint() if part == "lint" else tests(part, marks)
        took_s[part] = time.monotonic() - began_s
    print("\n== all parts")
    for part, found in failed.items():
        print(f"{part:8} {took_s[part]:4.0f} s  {len(found) or 'nothing'} failed")
        for line in found:
            print(f"    {line}")
    print(f"{'all':8} {sum(took_s.values()):4.0f} s, {os.cpu_count()} cores")
    return any(failed.values())


if __name__ == "__main__":
    raise SystemExit(main())
