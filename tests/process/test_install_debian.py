"""`deploy/install.sh` in a real Debian: opt-in, since it fetches some hundred megabytes.

    TROLLEY_TEST_DEBIAN=/var/tmp/bookworm python -m pytest tests/process/test_install_debian.py

The folder is made with debootstrap where it is not there, and copied for each run.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
VARIABLE = "TROLLEY_TEST_DEBIAN"
PACKAGES = "systemd,systemd-sysv,dbus,udev,python3,python3-venv,ca-certificates,procps"
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(VARIABLE not in os.environ, reason=f"opt-in: set {VARIABLE} to a folder"),
    pytest.mark.skipif(os.geteuid() != 0, reason="needs root"),
    pytest.mark.skipif(shutil.which("debootstrap") is None, reason="debootstrap is not installed"),
]


@pytest.fixture
def debian(tmp_path: Path) -> Iterator[Path]:
    """A fresh Debian 12 with this checkout in `/src`."""
    made, root = Path(os.environ.get(VARIABLE, "")), tmp_path / "debian"
    if not (made / "etc").exists():
        command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", "bookworm"]
        subprocess.run([*command, str(made)], check=True)
    subprocess.run(["cp", "-a", str(made), str(root)], check=True)
    # The network of the machine that tests, with the authorities that it trusts.
    for file in ("/etc/resolv.conf", CERTIFICATES):
        shutil.copy(file, root / file.lstrip("/"))
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    ).stdout
    for name in filter(None, listed.decode().split("\0")):
        (root / "src" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, root / "src" / name, follow_symlinks=False)
    for folder in ("proc", "dev"):
        subprocess.run(["mount", "--bind", f"/{folder}", str(root / folder)], check=True)
    yield root
    for folder in ("proc", "dev"):
        subprocess.run(["umount", str(root / folder)], check=True)


def run(root: Path, *command: str) -> str:
    """Run something in there; what it said."""
    environment = {
        "PATH": "/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "PIP_CERT": CERTIFICATES,
        "SSL_CERT_FILE": CERTIFICATES,
    }
    done = subprocess.run(
        ["chroot", str(root), *command],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def stamps(root: Path) -> dict[str, int]:
    """When each file was changed last."""
    folders = [root / name for name in ("opt", "etc", "usr/local", "var/lib/trolley")]
    paths = [path for folder in folders for path in folder.rglob("*")]
    return {str(path): path.lstat().st_mtime_ns for path in paths}


def test_a_robot_is_installed_upgraded_and_removed(debian: Path) -> None:
    said = run(debian, "/src/deploy/install.sh", "robot", "--name", "anna")
    assert "at the next boot" in said
    wants = debian / "etc/systemd/system/multi-user.target.wants/trolley-robot.target"
    assert wants.is_symlink()
    assert list((debian / "opt").rglob("*.nbc"))
    run(debian, "runuser", "-u", "trolley", "--", "trolley", "--version")
    before = stamps(debian)
    assert "Nothing to do" in run(debian, "/src/deploy/install.sh", "robot")
    assert stamps(debian) == before
    with (debian / "src/README.md").open("a") as readme:
        readme.write("\n")
    assert "is running. The state before" in run(debian, "/src/deploy/install.sh", "--upgrade")
    assert len(list((debian / "opt/trolley/releases").iterdir())) == 2
    run(debian, "/src/deploy/install.sh", "--uninstall")
    assert not (debian / "opt/trolley").exists()
    assert (debian / "etc/trolley/robot.toml").exists()
