"""`deploy/install.sh` against a root of its own, with stand-ins for what changes a system."""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.waiting import PATIENCE_S, wait_until

ROOT = Path(__file__).resolve().parents[2]

# Stand-ins; `$FAKE` is where they keep what they know. A release that holds `common/BROKEN` does
# not come up, and one with `common/UNHAPPY` makes `trolley status` complain.
STANDINS = {
    "id": """
        case "$*" in
            -u) echo "${FAKE_UID:-0}" ;;
            "-u trolley") [ -e "$FAKE/user" ] ;;
            "-nG trolley") cat "$FAKE/user" ;;
        esac""",
    "useradd": 'echo trolley > "$FAKE/user"',
    "usermod": 'echo dialout >> "$FAKE/user"',
    "userdel": 'rm "$FAKE/user"',
    "uname": 'echo "${FAKE_MACHINE:-x86_64}"',
    "journalctl": "echo what the journal says",
    "sync": "exit 0",
    "apt-get": 'echo "$*" >> "$FAKE/apt"; [ -z "$FAKE_OFFLINE" ]',
    "systemctl": """
        shift  # --root
        echo "$*" >> "$FAKE/systemctl"
        case "$1" in
            is-enabled) [ -e "$FAKE/enabled-$3" ] ;;
            enable) touch "$FAKE/enabled-$3" ;;
            disable) rm -f "$FAKE/enabled-$3" ;;
            start) touch "$FAKE/active" ;;
            stop) rm -f "$FAKE/active" ;;
            is-active)
                [ "$2" != --quiet ] || { [ -e "$FAKE/active" ]; exit; }
                shift
                for unit; do
                    if [ ! -e "$FAKE/active" ]; then echo inactive
                    elif [ -e "$FAKE_ROOT/opt/trolley/current/common/BROKEN" ]; then echo failed
                    else echo active; fi
                done ;;
            show) echo 0 ;;
        esac""",
}
FAKE_TROLLEY = """\
#!/bin/bash
release=${0%/*/*/*}
echo "${release##*/} $*" >> "$FAKE/trolley"
case "$1" in
    init) echo "[robot] # $3" > "$4" ;;
    backup) [ -z "$FAKE_FULL" ] || exit 1; cp -r "$3" "$FAKE/saved"; echo saved > "$4" ;;
    restore)
        [ -z "$FAKE_FULL_NOW" ] || exit 1
        [ -z "$FAKE_SLOW" ] || exec sleep 600
        rm -rf "$3"; cp -r "$FAKE/saved" "$3" ;;
    status) [ ! -e "$release/common/UNHAPPY" ] || { echo localizer is failed; exit 1; } ;;
esac
"""
# Makes an environment of stand-ins, and answers questions as the Python of this test.
FAKE_PYTHON = f"""\
#!/bin/bash
if [ "$1 $2" != "-m venv" ]; then
    case "$*" in *sys.version_info[:2]*exit*|*3,\\ 11*) [ -z "$FAKE_OLD_PYTHON" ] || exit 1 ;; esac
    case "$*" in *ensurepip*) [ -z "$FAKE_NO_VENV" ] || exit 1 ;; esac
    case "$*" in *calcsize*) echo "${{FAKE_BITS:-64}}"; exit ;; esac
    exec {sys.executable} "$@"
fi
mkdir -p "$3/bin"
cp "$FAKE/trolley.sh" "$3/bin/trolley"
cat > "$3/bin/python" <<'END'
#!/bin/bash
echo "python $*" >> "$FAKE/built"
[ -z "$FAKE_HANG" ] || [[ "$*" != *"$FAKE_HANG"* ]] || exec sleep 600
[ -z "$FAKE_BREAK" ] || [[ "$*" != *"$FAKE_BREAK"* ]]
END
cp "$3/bin/python" "$3/bin/uv"
chmod +x "$3"/bin/*
"""


class Host:
    """A root folder, a checkout, and the stand-ins."""

    def __init__(self, folder: Path) -> None:
        self.root, self.fake, self.checkout = folder / "root", folder / "fake", folder / "checkout"
        self._path = folder / "bin"
        for one in (self.root / "run/systemd/system", self.fake, self._path, self.checkout):
            one.mkdir(parents=True)
        for name, script in STANDINS.items():
            self._program(self._path / name, f"#!/bin/bash\n{script}\n")
        for name in ("python3", "python3.11", "python3.12", "python3.13"):
            self._program(self._path / name, FAKE_PYTHON)
        self._program(self.fake / "trolley.sh", FAKE_TROLLEY)
        shutil.copytree(ROOT / "deploy", self.checkout / "deploy")
        for name in ("requirements.lock", "README.md", "CHANGELOG.md", "LICENSE"):
            shutil.copy(ROOT / name, self.checkout / name)
        for name in ("common", "services/base"):
            (self.checkout / name).mkdir(parents=True)
            shutil.copy(ROOT / name / "pyproject.toml", self.checkout / name / "pyproject.toml")
        for name in ("docs", "worlds"):
            (self.checkout / name).mkdir()
            (self.checkout / name / "README.md").write_text("")

    def _program(self, path: Path, text: str) -> None:
        path.write_text(text)
        path.chmod(0o755)

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        """Start install.sh."""
        return subprocess.Popen(
            [
                "bash",
                str(self.checkout / "deploy/install.sh"),
                *arguments,
                "--root",
                str(self.root),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            env={
                **os.environ,
                "PATH": f"{self._path}:{os.environ['PATH']}",
                "FAKE": str(self.fake),
                "FAKE_ROOT": str(self.root),
                "TROLLEY_INSTALL_PATIENCE_S": "1",
                "TROLLEY_INSTALL_PAUSE_S": "0.02",
                **environment,
            },
        )

    def install(self, *arguments: str, code: int = 0, **environment: str) -> str:
        """Run install.sh to its end; what it said."""
        process = self.start(*arguments, **environment)
        said, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == code, said
        return said

    def snapshot(self) -> dict[str, tuple[str, int]]:
        """Content or target and modification time of all that lies in the root."""
        return {
            str(path.relative_to(self.root)): (
                str(path.readlink())
                if path.is_symlink()
                else hashlib.sha256(path.read_bytes()).hexdigest()
                if path.is_file()
                else "",
                path.lstat().st_mtime_ns,
            )
            for path in sorted(self.root.rglob("*"))
            if "run" not in path.relative_to(self.root).parts
        }

    def said(self, name: str) -> str:
        """What a stand-in was asked."""
        path = self.fake / name
        return path.read_text() if path.exists() else ""

    @property
    def current(self) -> str:
        """The release that runs."""
        return (self.root / "opt/trolley/current").readlink().name

    def change(self, name: str) -> None:
        """Make the checkout another version."""
        (self.checkout / "common" / name).write_text("changed\n")


@pytest.fixture
def host(tmp_path: Path) -> Host:
    return Host(tmp_path)


def test_a_robot_is_installed_and_the_second_run_changes_nothing(host: Host) -> None:
    said = host.install("robot", "--name", "anna")
    assert "is installed as a robot" in said
    assert "All services are up." in said
    units = host.root / "etc/systemd/system"
    assert (units / "trolley-base.service").read_bytes() == (
        ROOT / "deploy/systemd/trolley-base.service"
    ).read_bytes()
    assert (units / "trolley-.service.d/trolley.conf").exists()
    assert (host.root / "etc/trolley/robot.toml").read_text() == "[robot] # anna\n"
    assert "--require-hashes" in host.said("built")
    assert host.said("built").count("trolley.warmup") == 1
    assert host.said("user").split() == ["trolley", "dialout"]
    for line in ("daemon-reload", "enable --quiet trolley-robot.target"):
        assert line in host.said("systemctl")
    before = host.snapshot()
    built, asked = host.said("built"), host.said("trolley")
    time.sleep(0.01)
    assert "Nothing to do" in host.install("robot")
    assert host.snapshot() == before
    assert (host.said("built"), host.said("trolley")) == (built, asked)


def test_what_is_installed_can_be_built(host: Host) -> None:
    """Packages' README.md and LICENSE are links, and were left out: nothing could be installed."""
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("common", "services"):
        shutil.rmtree(host.checkout / name)
        shutil.copytree(ROOT / name, host.checkout / name, symlinks=True, ignore=ignored)
    host.install("robot")
    release = host.root / "opt/trolley/current"
    packages = [release / "common", *(release / "services").iterdir()]
    assert len(packages) > 5
    for package in packages:
        build = f"import hatchling.build; hatchling.build.build_editable({str(host.fake)!r})"
        subprocess.run([sys.executable, "-c", build], cwd=package, check=True)


@pytest.mark.parametrize("role", ["pc", "router"])
def test_other_hosts_enable_only_their_own(host: Host, role: str) -> None:
    host.install(role)
    assert sorted(path.name for path in host.fake.glob("enabled-*")) == [
        f"enabled-trolley-{role}.target"
    ]
    assert "Nothing to do" in host.install(role)
    assert "uninstall" in host.install("robot", code=1)


def test_settings_are_never_overwritten(host: Host) -> None:
    (host.root / "etc/trolley").mkdir(parents=True)
    (host.root / "etc/trolley/robot.toml").write_text("mine")
    host.install("robot")
    host.change("NEW")
    host.install("--upgrade")
    assert (host.root / "etc/trolley/robot.toml").read_text() == "mine"


def test_a_dry_run_does_nothing(host: Host) -> None:
    said = host.install("robot", "--dry-run", FAKE_UID="1000")
    assert "would run: useradd" in said
    assert host.snapshot() == {}
    host.install("robot")
    before = host.snapshot()
    host.change("NEW")
    assert "would switch" in host.install("--upgrade", "--dry-run")
    assert "would run: rm -rf" in host.install("--uninstall", "--purge", "--dry-run")
    assert host.snapshot() == before


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({"FAKE_UID": "1000"}, "sudo"),
        ({"FAKE_BITS": "32"}, "32-bit"),
        ({"FAKE_MACHINE": "riscv64"}, "riscv64"),
        ({"FAKE_OLD_PYTHON": "yes"}, "Python 3.11"),
    ],
)
def test_a_machine_that_cannot_is_told_why(
    host: Host, environment: dict[str, str], said: str
) -> None:
    assert said in host.install("robot", code=1, **environment)
    assert host.snapshot() == {}


@pytest.mark.parametrize(
    "arguments", [[], ["roboter"], ["robot", "--name", "A b"], ["robot", "--purge"], ["--upgrade"]]
)
def test_what_makes_no_sense_is_refused(host: Host, arguments: list[str]) -> None:
    host.install(*arguments, code=1)
    assert host.snapshot() == {}


def test_where_systemd_does_not_run_it_only_enables(host: Host) -> None:
    shutil.rmtree(host.root / "run/systemd")
    assert "at the next boot" in host.install("robot")
    assert (host.fake / "enabled-trolley-robot.target").exists()
    assert not (host.fake / "active").exists()
    assert "Nothing to do" in host.install("robot")


@pytest.mark.parametrize("step", ["pip install", "trolley.warmup", "compileall"])
def test_one_that_was_killed_can_be_run_again(host: Host, step: str) -> None:
    process = host.start("robot", FAKE_HANG=step)
    wait_until(lambda: step in host.said("built"), step)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert not (host.root / "opt/trolley/current").exists()
    host.install("robot")
    assert "Nothing to do" in host.install("robot")


def test_packages_that_cannot_be_fetched_leave_what_runs_as_it_is(host: Host) -> None:
    host.install("robot")
    old = host.current
    host.change("NEW")
    said = host.install("--upgrade", code=1, FAKE_BREAK="pip install")
    assert "Is this machine on the Internet?" in said
    assert host.current == old
    assert "stop" not in host.said("systemctl")
    host.install("--upgrade")
    assert host.current != old


def test_what_debian_leaves_out_is_fetched(host: Host) -> None:
    offline = host.install("robot", code=1, FAKE_NO_VENV="yes", FAKE_OFFLINE="yes")
    assert "Is there a network?" in offline
    host.install("robot", FAKE_NO_VENV="yes")
    assert "-venv" in host.said("apt").splitlines()[-1]


@pytest.mark.parametrize(("counted", "is_told"), [("cpu io memory pids", False), ("cpu io", True)])
def test_limits_without_effect_are_told(host: Host, counted: str, is_told: bool) -> None:
    controllers = host.root / "sys/fs/cgroup/cgroup.controllers"
    controllers.parent.mkdir(parents=True)
    controllers.write_text(counted + "\n")
    assert ("cgroup_enable=memory" in host.install("robot")) == is_told


def test_an_upgrade_switches_and_keeps_the_one_before(host: Host) -> None:
    host.install("robot")
    first = host.current
    host.change("NEW")
    assert "install.sh --upgrade" in host.install("robot")
    assert host.current == first
    backups: list[Path] = []
    for number in range(3):
        before = host.current
        host.change(f"NEW{number}")
        said = host.install("--upgrade")
        assert host.current != before
        assert "This failed" not in said
        backups.append(Path(said.split("The state before it: ")[1].split("\n")[0]))
    assert set((host.root / "var/backups/trolley").iterdir()) == set(backups[-2:])
    releases = {path.name for path in (host.root / "opt/trolley/releases").iterdir()}
    assert releases == {before, host.current}
    assert "Nothing to do" in host.install("--upgrade")


@pytest.mark.parametrize(
    ("flaw", "said"), [("BROKEN", "trolley-router.service is failed"), ("UNHAPPY", "localizer")]
)
def test_an_upgrade_that_does_not_come_up_is_taken_back(host: Host, flaw: str, said: str) -> None:
    host.install("robot")
    first = host.current
    (host.root / "var/lib/trolley/poses.toml").write_text("kitchen")
    (host.checkout / "deploy/systemd/trolley-new.service").write_text("[Service]\n")
    host.change(flaw)
    told = host.install("--upgrade", code=1)
    assert said in told
    assert f"Trolley {first} is running again" in told
    assert host.current == first
    assert (host.root / "var/lib/trolley/poses.toml").read_text() == "kitchen"
    assert not (host.root / "etc/systemd/system/trolley-new.service").exists()
    assert (host.fake / "active").exists()
    (host.checkout / "common" / flaw).unlink()
    host.install("--upgrade")
    assert host.current != first


def test_settings_that_a_release_refuses_are_told_before_anything_is_stopped(host: Host) -> None:
    host.install("robot")
    first = host.current
    host.change("NEW")
    said = host.install("--upgrade", code=1, FAKE_BREAK="-m trolley.config")
    assert "cannot use the settings of this host" in said
    assert host.current == first
    assert "stop" not in (host.fake / "systemctl").read_text()
    host.install("--upgrade")
    assert host.current != first


def test_a_state_that_cannot_be_saved_leaves_what_ran_running(host: Host) -> None:
    """On a full disk the robot stood there, stopped."""
    host.install("robot")
    first = host.current
    host.change("NEW")
    said = host.install("--upgrade", code=1, FAKE_FULL="yes")
    assert f"so {first} goes on" in said
    assert host.current == first
    assert (host.fake / "active").exists()
    host.install("--upgrade")
    assert host.current != first


@pytest.mark.parametrize("is_good", [True, False])
def test_an_upgrade_that_was_cut_short_is_finished_by_the_next_run(
    host: Host, is_good: bool
) -> None:
    host.install("robot")
    first = host.current
    host.change("NEW" if is_good else "BROKEN")
    process = host.start("--upgrade", TROLLEY_INSTALL_PAUSE_S="600")
    wait_until(lambda: host.current != first and (host.fake / "active").exists(), "it has switched")
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    built = host.said("built")
    said = host.install("robot", code=0 if is_good else 1)
    assert "cut short" in said
    assert (host.current != first) == is_good
    assert host.said("built") == built, "the release that runs was deleted, and built again"
    assert not (host.root / "opt/trolley/upgrading").exists()


def test_a_power_cut_while_an_upgrade_is_taken_back_leaves_no_state_of_the_new_release(
    host: Host,
) -> None:
    host.install("robot")
    first, poses = host.current, host.root / "var/lib/trolley/poses.toml"
    poses.write_text("kitchen")
    host.change("BROKEN")
    process = host.start("--upgrade", FAKE_SLOW="yes")
    wait_until(lambda: "restore" in host.said("trolley"), "it goes back")
    poses.write_text("as only the new release knows it")
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert "cut short" in host.install("--upgrade", code=1)
    assert host.current == first
    assert poses.read_text() == "kitchen"
    (host.checkout / "common/BROKEN").unlink()
    host.install("--upgrade")
    assert poses.read_text() == "kitchen"


def test_a_state_that_cannot_be_put_back_is_put_back_by_the_next_run(host: Host) -> None:
    host.install("robot")
    first = host.current
    host.change("BROKEN")
    assert "could not be put back" in host.install("--upgrade", code=1, FAKE_FULL_NOW="yes")
    assert "is running again" in host.install("--upgrade", code=1)
    assert host.current == first


@pytest.mark.parametrize("goes_back", [True, False])
def test_a_state_that_can_never_be_put_back_is_left_alone_and_the_user_goes_on(
    host: Host, goes_back: bool
) -> None:
    host.install("robot")
    first = host.current
    host.change("BROKEN")
    for said in ("run this again", "it is not tried any more"):
        told = host.install("--upgrade", code=1, FAKE_FULL_NOW="yes")
        assert said in told
    if goes_back:
        before = host.root / f"opt/trolley/releases/{first}"
        assert f"sudo {before}/deploy/install.sh --upgrade" in told
        host.checkout = before
    else:
        (host.checkout / "common/BROKEN").rename(host.checkout / "common/MENDED")
    host.install("--upgrade")
    assert (host.current == first) is goes_back
    assert (host.fake / "active").exists()


def test_uninstalling_keeps_what_people_made_unless_told(host: Host) -> None:
    host.install("robot")
    (host.root / "var/lib/trolley/poses.toml").write_text("kitchen")
    override = host.root / "etc/systemd/system/trolley-base.service.d/mine.conf"
    override.parent.mkdir()
    override.write_text("")
    (host.fake / "enabled-trolley-viz.service").touch()  # by hand
    host.install("--uninstall")
    left = {path for path, _ in host.snapshot().items() if (host.root / path).is_file()}
    assert left == {
        "etc/trolley/robot.toml",
        "var/lib/trolley/poses.toml",
        "etc/systemd/system/trolley-base.service.d/mine.conf",
    }
    assert not list(host.fake.glob("enabled-*"))
    assert "not installed" in host.install("--uninstall")
    host.install("robot")
    assert (host.root / "var/lib/trolley/poses.toml").read_text() == "kitchen"
    host.install("--uninstall", "--purge")
    assert not (host.root / "var/lib/trolley").exists()
    assert not (host.root / "etc/trolley").exists()
    assert not (host.fake / "user").exists()


def test_only_one_runs_at_a_time(host: Host) -> None:
    process = host.start("robot", FAKE_HANG="trolley.warmup")
    wait_until(lambda: "trolley.warmup" in host.said("built"), "it warms up")
    assert "Another install.sh" in host.install("robot", code=1)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
