"""Trolley installed from wheels, far from a clone, as pipx does it."""

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from zipfile import ZipFile

import pytest
from support.processes import find_free_port

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [ROOT / "common", *sorted(path.parent for path in ROOT.glob("services/*/pyproject.toml"))]
LIMIT_S = 300.0


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("wheels")
    for source in SOURCES:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
        subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=LIMIT_S)
    return sorted(folder.iterdir())


def test_wheels_bring_all_that_is_needed_and_no_leftovers(wheels: list[Path]) -> None:
    names = [name for wheel in wheels for name in ZipFile(wheel).namelist()]
    for end in ("worlds/apartment.pgm", "frontend/index.html", "languages/de.toml"):
        assert any(name.endswith(end) for name in names), end
    assert not [name for name in names if "__pycache__" in name or "/tests/" in name]


def test_the_demo_runs_from_wheels_without_a_clone(
    wheels: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHONPATH", raising=False)  # which may name the clone
    run = {"check": True, "timeout": LIMIT_S, "cwd": tmp_path}
    subprocess.run([sys.executable, "-m", "venv", "env"], **run)
    python = tmp_path / "env" / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps"]
    subprocess.run([*pip, *wheels], **run)
    # Other people's packages come from here: lines of a .pth file there are not looked at again,
    # so none of it leads to the clone.
    site = next((tmp_path / "env" / "lib").glob("python*/site-packages"))
    (site / "others.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    # What is compiled in the clone counts there as well: to compile it all again takes minutes.
    for kept in [path for one in SOURCES for path in one.rglob("__pycache__/*.nbc")]:
        there = site / kept.relative_to(next(one for one in SOURCES if kept.is_relative_to(one)))
        there.parent.mkdir(exist_ok=True)
        shutil.copy(kept, there)
    where = subprocess.check_output(
        [python, "-c", "import trolley, trolley_base as b; print(trolley.__file__, b.__file__)"],
        text=True,
        cwd=tmp_path,
    )
    assert where.count(str(site)) == 2
    port = str(find_free_port())
    demo = ["demo", "--headless", "--tour", "--speed", "4", "--seed", "7", "--port", port]
    done = subprocess.run(
        [tmp_path / "env" / "bin" / "trolley", *demo],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 collisions" in done.stdout
