"""Compiling the kernels at set-up."""

import contextlib
import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from trolley import warmup
from trolley.jit import KernelFiles
from trolley.warmup import Progress

BEGINNING = Progress()
SQUARES = """
from trolley.jit import kernel


@kernel
def square(x):
    return x * x


@kernel
def cube(x):
    return x * x * x


@kernel
def twice(x):
    return x + x
"""


def run(progress: Progress = BEGINNING) -> Progress | None:
    """Compile; how far it came where it would begin anew."""

    class BeginsAnewError(Exception):
        pass

    handed_on: list[Progress] = []

    def begin_anew(progress: Progress) -> None:
        handed_on.append(progress)
        raise BeginsAnewError

    with contextlib.suppress(BeginsAnewError):
        warmup.main(progress, begin_anew)
    return handed_on[0] if handed_on else None


def test_every_part_is_named_as_it_is_compiled(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[str] = []
    parts = {"common": lambda: called.append("common"), "base": lambda: called.append("base")}
    monkeypatch.setattr(warmup, "warm_ups", lambda: parts)
    run()
    assert called == ["common", "base"]
    assert "[2/2] base ..." in capsys.readouterr().out


def test_services_with_kernels_bring_their_warm_up() -> None:
    parts = warmup.warm_ups()
    assert {"common", "localizer", "planner"} <= set(parts)
    assert not {"tour", "viz"} & set(parts)
    parts["common"]()


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A service with a kernel, as an installer leaves it."""
    package = folder / "trolley_new"
    (package / "deep" / "__pycache__").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "warmup.py").touch()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    entry = EntryPoint("new", "trolley_new.service:New", warmup.SERVICES)
    monkeypatch.setattr(warmup, "entry_points", lambda group: [entry])
    return package


def test_a_new_installation_has_nothing_compiled(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    package = installed(tmp_path, monkeypatch)
    assert warmup.nothing_is_compiled()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not warmup.nothing_is_compiled()
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    (package / "deep" / "__pycache__" / "one.nbc").touch()
    assert not warmup.nothing_is_compiled()


def squares_in(folder: Path) -> Any:
    """Loads a module with three kernels anew, as a new process does."""
    module = folder / "squares.py"
    module.write_text(SQUARES)
    spec = importlib.util.spec_from_file_location("squares", module)
    assert spec is not None
    assert spec.loader is not None
    squares = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(squares)
    return squares


def test_a_kernel_that_is_compiled_shows_as_a_dot(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    squares = squares_in(tmp_path)
    monkeypatch.setattr(warmup, "warm_ups", lambda: {"squares": lambda: squares.square(2.0)})
    run()
    assert "[1/1] squares ...." in capsys.readouterr().out
    run()  # compiled already
    assert "[1/1] squares ... " in capsys.readouterr().out


def test_many_kernels_are_compiled_by_several_processes_so_none_grows_large(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(warmup, "MOST_MB", 0)

    def warm_ups() -> dict[str, Callable[[], None]]:
        squares = squares_in(tmp_path)

        def two() -> None:
            squares.square(2.0)
            squares.cube(2.0)

        return {"two": two, "one": lambda: squares.twice(2.0)}

    monkeypatch.setattr(warmup, "warm_ups", warm_ups)
    second = run()
    assert second is not None
    third = run(second)
    assert third is not None
    assert (second.part, third.part, third.run) == (1, 2, 3)
    assert run(third) is None
    said = capsys.readouterr().out
    lines = r"\[1/2\] two \.+ \S+ s\n\[2/2\] one \.+ \S+ s\nAll kernels are compiled .*\n"
    assert re.fullmatch(lines, said)


def test_a_process_whose_kernels_cannot_be_kept_compiles_all_of_them_itself(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(warmup, "MOST_MB", 0)
    monkeypatch.setattr(KernelFiles, "save", lambda *_: None)  # as on a full disk
    squares = squares_in(tmp_path)

    def two() -> None:
        squares.square(2.0)
        squares.cube(2.0)

    monkeypatch.setattr(warmup, "warm_ups", lambda: {"two": two})
    assert run() is None


# In a process of its own: in that of other tests everything is compiled already.
COLD = """
import ast, importlib, inspect, pkgutil, sys

package = importlib.import_module(sys.argv[1])
names = [one.name for one in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
modules = [importlib.import_module(name) for name in names if not name.endswith("__main__")]
importlib.import_module(sys.argv[1] + ".warmup").warm_up()

def calls(node):
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Call) and isinstance(child.func, ast.Name):
            yield child.func.id
        marks = getattr(child, "decorator_list", [])
        if not any("kernel" in ast.unparse(mark) for mark in marks):
            yield from calls(child)

for module in modules:
    for name in sorted(set(calls(ast.parse(inspect.getsource(module))))):
        if not getattr(getattr(module, name, None), "signatures", True):
            print(module.__name__, name)
"""
ONLY_OF_TESTS = {"trolley_localizer.filter.particle_filter weigh_by_scan"}
"""Called by what is for tests and benches only."""


@pytest.mark.programs
@pytest.mark.parametrize("service", ["base", "localizer", "mapper", "planner"])
def test_no_kernel_that_is_called_from_python_is_left_to_be_compiled(service: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", COLD, f"trolley_{service}"],
        capture_output=True,
        text=True,
        timeout=500.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.splitlines()) <= ONLY_OF_TESTS
