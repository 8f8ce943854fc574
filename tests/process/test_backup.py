"""`trolley backup` and `trolley restore` as people use them."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Trolley = Callable[..., subprocess.CompletedProcess[str]]
CONFIG = '[robot]\nname = "one"\nfootprint = {{radius_m = 0.2}}\n[zenoh]\nconnect = ["{}"]\n'


@pytest.fixture
def config(tmp_path: Path, endpoint: str) -> Path:
    """A robot that has been used: its robot.toml and its state."""
    (tmp_path / "etc").mkdir()
    path = tmp_path / "etc" / "robot.toml"
    path.write_text(CONFIG.format(endpoint))
    state = tmp_path / "cli-state" / "one"
    state.mkdir(parents=True)
    (state / "poses.toml").write_text("[kitchen]\nx = 1.0\n")
    return path


def test_a_backup_is_made_while_the_robot_runs_and_put_back_only_when_it_does_not(
    trolley: Trolley, add_robot: Callable[..., object], config: Path, tmp_path: Path
) -> None:
    add_robot("one")
    made = trolley("--config", str(config), "backup", "saved.tar.gz")
    assert (made.returncode, made.stderr) == (0, "")
    assert made.stdout.startswith("Saved 2 files in saved.tar.gz")
    poses = tmp_path / "cli-state" / "one" / "poses.toml"
    poses.write_text("[cellar]\nx = 2.0\n")
    refused = trolley("--config", str(config), "restore", "saved.tar.gz")
    assert refused.returncode != 0
    assert "these services are running on this host: base" in refused.stderr
    assert "cellar" in poses.read_text()
    again = trolley("--config", str(config), "backup", "saved.tar.gz")
    assert again.returncode != 0
    assert "already exists; not overwritten" in again.stderr


def test_all_is_put_back(trolley: Trolley, config: Path, tmp_path: Path) -> None:
    text, state = config.read_text(), tmp_path / "cli-state"
    (tmp_path / "kept").mkdir()
    made = json.loads(trolley("--config", str(config), "backup", "kept", "--json").stdout)
    (saved,) = (tmp_path / "kept").iterdir()
    assert made == {
        "file": f"kept/{saved.name}",
        "bytes": saved.stat().st_size,
        "files": 2,
        "left_out": [],
    }
    config.write_text(text.replace("0.2", "0.3"))
    (state / "one" / "poses.toml").unlink()
    only = trolley("restore", str(saved), "--state-only", "--config", str(config), "--json")
    assert (only.returncode, only.stderr) == (0, "")
    assert [Path(one).exists() for one in json.loads(only.stdout)["kept"]] == [True]
    assert "0.3" in config.read_text()
    assert "kitchen" in (state / "one" / "poses.toml").read_text()
    both = trolley("restore", str(saved), "--config", str(config))
    assert both.returncode == 0
    assert config.read_text() == text
    kept = [Path(line.partition(": ")[2]) for line in both.stdout.splitlines() if "before" in line]
    assert [path.exists() for path in kept] == [True, True]


def test_what_is_no_backup_is_refused(trolley: Trolley, config: Path, tmp_path: Path) -> None:
    (tmp_path / "cat.tar.gz").write_bytes(b"meow")
    refused = trolley("--config", str(config), "restore", "cat.tar.gz")
    assert refused.returncode != 0
    assert "cat.tar.gz is not a backup" in refused.stderr
    assert "kitchen" in (tmp_path / "cli-state" / "one" / "poses.toml").read_text()
