"""`deploy/install.sh` in a real Debian that has booted: opt-in, since it fetches some hundred MB.

    TROLLEY_TEST_DEBIAN=/var/tmp/bookworm python -m pytest tests/process/test_install_debian.py

The folder is made with debootstrap where it is not there, of the release that it is named after,
and copied for each run. The Debian shares this machine's network, so no router may run here.
"""

import contextlib
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.processes import children_of
from support.waiting import wait_until

ROOT = Path(__file__).resolve().parents[2]
VARIABLE = "TROLLEY_TEST_DEBIAN"
PACKAGES = "systemd,systemd-sysv,dbus,udev,python3,python3-venv,ca-certificates,procps"
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
INSTALL = "/src/deploy/install.sh"
ENVIRONMENT = {
    "PATH": "/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "PIP_CERT": CERTIFICATES,
    "SSL_CERT_FILE": CERTIFICATES,
}
SERVICES = [f"trolley-{name}" for name in ("base", "localizer", "mapper", "planner", "tour")]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(VARIABLE not in os.environ, reason=f"opt-in: set {VARIABLE} to a folder"),
    pytest.mark.skipif(os.geteuid() != 0, reason="needs root"),
    *(
        pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")
        for program in ("debootstrap", "systemd-nspawn")
    ),
]


class Debian:
    """A Debian in a folder, booted by its own systemd."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.boot()

    def boot(self) -> None:
        """Switch it on, and wait until it runs."""
        options = ["--register=no", "--keep-unit", "--resolv-conf=off", "--capability=all"]
        self._host = subprocess.Popen(
            ["systemd-nspawn", "--quiet", *options, "--boot", f"--directory={self.root}"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._init = wait_until(self._find_init, "its systemd is started")
        wait_until(
            lambda: self.asks("systemctl", "is-system-running").strip() == "running", "it runs"
        )

    def _find_init(self) -> int:
        for child in children_of(self._host.pid):
            with contextlib.suppress(FileNotFoundError):
                if Path(f"/proc/{child}/comm").read_text() == "systemd\n":
                    return child
        return 0

    def cut_power(self) -> None:
        """Switch it off, without any warning."""
        os.kill(self._init, signal.SIGKILL)
        self._host.wait()

    def start(self, *command: str) -> subprocess.Popen[str]:
        """Start something in there."""
        return subprocess.Popen(
            ["nsenter", f"--target={self._init}", "--all", "--", *command],
            env=ENVIRONMENT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def asks(self, *command: str) -> str:
        """Run something in there; what it said."""
        return self.start(*command).communicate()[0]

    def runs(self, *command: str, code: int = 0) -> str:
        """Run something in there that must end with a code; what it said."""
        process = self.start(*command)
        said, _ = process.communicate()
        assert process.returncode == code, said
        return said

    def stamps(self) -> dict[str, int]:
        """When each file was changed last."""
        folders = [self.root / name for name in ("opt", "etc/systemd", "etc/trolley", "usr/local")]
        paths = [path for folder in folders for path in folder.rglob("*")]
        return {str(path): path.lstat().st_mtime_ns for path in paths}


@pytest.fixture
def debian(tmp_path: Path) -> Iterator[Debian]:
    """A fresh Debian with this checkout in `/src`."""
    made, root = Path(os.environ.get(VARIABLE, "")), tmp_path / "debian"
    if not (made / "etc").exists():
        command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", made.name]
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
    system = Debian(root)
    yield system
    system.cut_power()


def test_a_robot_is_installed_upgraded_and_removed(debian: Debian) -> None:
    releases, readme = debian.root / "opt/trolley/releases", debian.root / "src/README.md"
    said = debian.runs(INSTALL, "robot", "--name", "anna")
    assert "All services are up." in said
    before = debian.stamps()
    assert "Nothing to do" in debian.runs(INSTALL, "robot")
    assert debian.stamps() == before
    for service in SERVICES:
        debian.runs("systemctl", "kill", "--signal=KILL", service)
        wait_until(lambda one=service: is_up_again(debian, one), f"{service} is back")
    debian.runs("systemctl", "stop", "trolley-tour")
    wait_until(lambda: not rests(debian), "all that began with the failures has ended", 90.0)
    assert not is_active(debian, "trolley-tour")
    debian.runs("systemctl", "start", "trolley-tour")

    readme.write_text(readme.read_text() + "\n")
    upgrade = debian.start(INSTALL, "--upgrade")
    assert upgrade.stdout is not None
    while not upgrade.stdout.readline().startswith("Saved "):
        assert upgrade.poll() is None
    debian.cut_power()
    upgrade.communicate()
    debian.boot()
    said = debian.runs(INSTALL, "--upgrade")
    assert "is running. The state before" in said
    assert "Making the environment" not in said
    assert len(list(releases.iterdir())) == 2

    planner = debian.root / "src/services/planner/trolley_planner/service.py"
    planner.write_text(f"raise RuntimeError('broken on purpose')\n{planner.read_text()}")
    said = debian.runs(INSTALL, "--upgrade", code=1)
    assert "is running again, with the state from before" in said
    assert "broken on purpose" in said
    assert all(is_active(debian, service) for service in SERVICES)

    debian.runs(INSTALL, "--uninstall")
    assert not (debian.root / "opt/trolley").exists()
    assert (debian.root / "etc/trolley/robot.toml").exists()


def rests(debian: Debian) -> str:
    return debian.asks(
        "systemctl", "list-units", "--no-legend", "--state=activating", "trolleyretry@*"
    )


def is_active(debian: Debian, service: str) -> bool:
    return debian.asks("systemctl", "is-active", service).strip() == "active"


def is_up_again(debian: Debian, service: str) -> bool:
    restarts = debian.asks("systemctl", "show", "--property=NRestarts", "--value", service)
    return restarts.strip() == "1" and is_active(debian, service)
