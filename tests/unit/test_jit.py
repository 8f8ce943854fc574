"""Compiled code on disk: shared, never stale, and never in the way."""

import contextlib
import hashlib
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from support.read_only import READ_ONLY

pytestmark = pytest.mark.programs

INNER = """
from trolley.jit import kernel

FACTOR = 2.0

@kernel
def scaled(x):
    return FACTOR * x
"""
OUTER = """
import logging, sys
from typing import NamedTuple
import inner
from inner import scaled
from trolley.jit import kernel

logging.basicConfig()

class Pair(NamedTuple):
    a: float
    b: float

@kernel
def total(pair, n):
    out = 0.0
    for i in range(n):
        out += scaled(pair.a) + pair.b / pair.b
    return out

if __name__ == "__main__":
    kinds = sys.argv[1:] or ["float"]
    for kind in kinds:
        value = {"float": 1.0, "int": 1, "bool": True}[kind]
        print(kind, total(Pair(value, value), 3), sum(total.stats.cache_hits.values()))
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A folder with two modules of kernels, one calling the other."""
    return make_tree(tmp_path)


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A tree whose kernels were compiled, kept as it was then, and what the program printed."""
    tree = make_tree(tmp_path_factory.mktemp("first"))
    out = run(tree)
    shutil.copytree(tree.parent, kept_beside(tree))
    return tree, out


@pytest.fixture
def compiled_tree(first_run: tuple[Path, str]) -> Path:
    """The same tree, after one run; always in the same place, which numba's cache goes by."""
    tree, _ = first_run
    shutil.rmtree(tree.parent)
    shutil.copytree(kept_beside(tree), tree.parent)
    return tree


def make_tree(parent: Path) -> Path:
    """Write the modules into a new folder; the cache will be beside it."""
    folder = parent / "case" / "tree"
    folder.mkdir(parents=True)
    (folder / "inner.py").write_text(INNER)
    (folder / "outer.py").write_text(OUTER)
    return folder


def kept_beside(tree: Path) -> Path:
    """Where the folder of a tree and its cache are kept."""
    return tree.parent.with_name("kept")


def start(tree: Path, *kinds: str, **environment: str) -> subprocess.Popen[str]:
    """Start the program with a cache folder beside the tree, unless the environment says more."""
    # Python tells a changed module by size and whole seconds: changes here are quicker than that.
    always = {"NUMBA_CACHE_DIR": str(tree.parent / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    settings = {**os.environ, **always, **environment}
    return subprocess.Popen(
        [sys.executable, "outer.py", *kinds],
        cwd=tree,
        env={name: value for name, value in settings.items() if value},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def run(tree: Path, *kinds: str, **environment: str) -> str:
    """Run the program to its end and return what it prints: kind, result, hits in the cache."""
    process = start(tree, *kinds, **environment)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out + err


def compiled(folder: Path) -> list[Path]:
    """All compiled files below a folder."""
    return sorted(folder.rglob("*.nbc"))


def test_second_process_finds_the_code_of_the_first(
    first_run: tuple[Path, str], compiled_tree: Path
) -> None:
    assert first_run[1] == "float 9.0 0\n"
    assert run(compiled_tree) == "float 9.0 1\n"


def test_whoever_waits_for_the_process_hears_of_each_kernel_that_is_compiled(tree: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind(str(tree / "notify"))
        supervisor.setblocking(False)

        def num_heard() -> int:
            run(tree, NOTIFY_SOCKET=str(tree / "notify"))
            words: list[bytes] = []
            with contextlib.suppress(BlockingIOError):
                while True:
                    words.append(supervisor.recv(4096))
            return sum(b"EXTEND_TIMEOUT_USEC=" in word for word in words)

        assert num_heard() == 4  # before and after `total`, and `scaled` in it
        assert num_heard() == 0  # read from the disk


def test_it_compiles_where_it_may_not_tell_the_one_whose_environment_it_has(tree: Path) -> None:
    """As another user's program, by `su` in a shell of systemd's."""
    listener, other = (socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2))
    with listener, other:
        listener.bind(str(tree / "notify"))
        other.bind(str(tree / "other"))
        listener.connect(str(tree / "other"))  # so that nobody else may send
        assert run(tree, NOTIFY_SOCKET=str(tree / "notify")) == "float 9.0 0\n"


def test_code_that_was_read_can_still_be_called_by_what_is_compiled(compiled_tree: Path) -> None:
    source = (compiled_tree / "outer.py").read_text()
    reads_first = "print(scaled(1.0), sum(scaled.stats.cache_hits.values()))\n    kinds = sys"
    (compiled_tree / "outer.py").write_text(
        source.replace("pair.b / pair.b", "pair.b").replace("kinds = sys", reads_first)
    )
    assert run(compiled_tree) == "2.0 1\nfloat 9.0 0\n"


def test_kernels_do_not_load_scipy(compiled_tree: Path) -> None:
    (compiled_tree / "outer.py").write_text(
        "import sys\nfrom inner import scaled\nprint(scaled(1.0), 'scipy.linalg' in sys.modules)\n"
    )
    assert run(compiled_tree) == "2.0 False\n"


@pytest.mark.slow
def test_processes_that_compile_at_the_same_moment_do_not_mix(tree: Path) -> None:
    kinds = ["float", "int", "bool"]
    processes = [start(tree, kind) for kind in kinds]
    for kind, process in zip(kinds, processes, strict=True):
        out, err = process.communicate(timeout=120)
        assert out == f"{kind} 9.0 0\n", err
    assert run(tree, *kinds) == "float 9.0 1\nint 9.0 2\nbool 9.0 3\n"


def test_damaged_code_is_compiled_again(compiled_tree: Path) -> None:
    for file, damage in zip(compiled(compiled_tree.parent), (b"", b"x" * 5000), strict=True):
        file.write_bytes(damage)
    assert run(compiled_tree) == "float 9.0 0\n"
    assert run(compiled_tree) == "float 9.0 1\n"


@pytest.mark.slow
def test_code_that_names_a_class_of_an_older_version_is_compiled_again(compiled_tree: Path) -> None:
    payload = b"ctrolley.jit\nMovedElsewhere\n."
    for file in compiled(compiled_tree.parent):
        file.write_bytes(hashlib.sha256(payload).digest() + payload)
    assert run(compiled_tree) == "float 9.0 0\n"


@pytest.mark.slow
def test_code_cut_short_is_compiled_again(compiled_tree: Path) -> None:
    for file in compiled(compiled_tree.parent):
        file.write_bytes(file.read_bytes()[:-1])
    assert run(compiled_tree) == "float 9.0 0\n"


@pytest.mark.parametrize(
    ("before", "after", "result"),
    [
        ("FACTOR = 2.0", "FACTOR = 5.0", 18.0),
        ("return FACTOR * x", "return FACTOR * x + 1", 12.0),
        ("@kernel", "@lean_kernel", 9.0),
        ("@kernel", "@loose_kernel('contract')", 9.0),
    ],
)
def test_change_in_another_file_is_seen(
    compiled_tree: Path, before: str, after: str, result: float
) -> None:
    inner = INNER.replace(before, after).replace(
        "import kernel", "import kernel, lean_kernel, loose_kernel"
    )
    (compiled_tree / "inner.py").write_text(inner)
    assert run(compiled_tree) == f"float {result} 0\n"
    assert len(compiled(compiled_tree.parent)) == 2  # what the older version left is gone


@pytest.mark.slow
def test_kernels_made_by_one_function_do_not_drop_each_other(tree: Path) -> None:
    (tree / "outer.py").write_text(
        "from trolley.jit import kernel\n"
        "def make(step):\n"
        "    @kernel\n"
        "    def after(x):\n"
        "        return x + step\n"
        "    return after\n"
        "one, two = make(1), make(2)\n"
        "print(one(1), two(1), *(sum(f.stats.cache_hits.values()) for f in (one, two)))\n"
    )
    assert run(tree) == "2 3 0 0\n"
    assert run(tree) == "2 3 1 1\n"


@pytest.mark.slow
def test_exchanged_fields_of_a_tuple_are_seen(tree: Path) -> None:
    source = OUTER.replace("Pair(value, value)", "Pair(a=value, b=4 * value)")
    source = source.replace("pair.b / pair.b", "pair.b")
    (tree / "outer.py").write_text(source)
    assert run(tree) == "float 18.0 0\n"
    swapped = source.replace("    a: float\n    b: float", "    b: float\n    a: float")
    (tree / "outer.py").write_text(swapped)
    assert run(tree) == "float 18.0 0\n"


@pytest.mark.slow
def test_settings_that_change_code_are_kept_apart(compiled_tree: Path) -> None:
    assert run(compiled_tree, NUMBA_BOUNDSCHECK="1") == "float 9.0 0\n"


@pytest.mark.slow
def test_read_only_tree_uses_the_user_s_cache(tree: Path) -> None:
    if os.geteuid() == 0:
        # Root may write anywhere: a file in the place of the folder has the same effect.
        (tree / "__pycache__").write_text("not a folder")
    else:
        tree.chmod(0o555)
    home = tree.parent / "home"
    environment = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": str(home)}
    assert run(tree, **environment) == "float 9.0 0\n"
    assert len(compiled(home)) == 2
    assert run(tree, **environment) == "float 9.0 1\n"
    tree.chmod(0o755)


@pytest.mark.slow
def test_code_beside_the_source_is_read_where_another_cache_is_written(tree: Path) -> None:
    assert run(tree, NUMBA_CACHE_DIR="") == "float 9.0 0\n"
    assert len(compiled(tree / "__pycache__")) == 2
    assert run(tree) == "float 9.0 1\n"


def test_without_a_folder_to_write_it_still_runs_and_says_so(tree: Path) -> None:
    (tree / "__pycache__").write_text("not a folder")
    blocked = tree.parent / "blocked"
    blocked.write_text("not a folder")
    out = run(tree, NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(blocked))
    assert out.startswith("float 9.0 0\n")
    assert out.count("cannot be cached") == 1  # not once for each kernel
    assert "NUMBA_CACHE_DIR" in out


def test_code_beside_the_source_is_read_where_nothing_can_be_written(compiled_tree: Path) -> None:
    (compiled_tree / "__pycache__").mkdir(exist_ok=True)
    for file in compiled(compiled_tree.parent / "cache"):
        shutil.copy(file, compiled_tree / "__pycache__")
    parent = compiled_tree.parent
    done = subprocess.run(
        [sys.executable, "-c", READ_ONLY, str(parent), sys.executable, "outer.py"],
        cwd=compiled_tree,
        env={**os.environ, "NUMBA_CACHE_DIR": str(parent), "XDG_CACHE_HOME": str(parent)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout + done.stderr == "float 9.0 1\n"


def test_kernels_run_uncompiled_where_numba_is_switched_off(tree: Path) -> None:
    program = "import outer; print(outer.total(outer.Pair(1.0, 1.0), 3))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tree,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "9.0\n"
