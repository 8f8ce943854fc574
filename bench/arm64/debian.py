"""A Debian 12 for 64-bit ARM in a folder, whose programs run here under emulation.

Each command runs in namespaces of its own: what it mounts and starts is gone with it, also when
it, or who started it, is killed.
"""

import fcntl
import os
import platform
import shutil
import ssl
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

RELEASE = "bookworm"
PACKAGES = "ca-certificates,git,make,python3,python3-venv"
"""What somebody needs beside Debian's smallest system, says CONTRIBUTING.md."""
KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
FREE_GB = 6
"""What the folder grows to, and a bit."""
EMULATOR = Path("/proc/sys/fs/binfmt_misc/qemu-aarch64")
PROCESSOR = "cortex-a72"
"""A Pi 4's; a Pi 3 and a Pi 5 have all of its instructions, so that code which needs newer ones
fails here. Only AES and SHA are none of a Pi 3's and 4's, but the emulator's."""
CPUINFO = """\
processor\t: 0
Features\t: fp asimd evtstrm crc32 cpuid
CPU implementer\t: 0x41
CPU architecture: 8
CPU variant\t: 0x0
CPU part\t: 0xd08
CPU revision\t: 3
"""
"""What Linux tells of it on a Pi 4, where numba's compiler looks up what to compile for."""
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
PIP_SETTINGS = (
    "index-url",
    "extra-index-url",
    "trusted-host",
    "proxy",
    "timeout",
    "default-timeout",
    "retries",
)
"""What says the way to the packages; others name files of this machine."""
PROXIES = ("http_proxy", "https_proxy", "no_proxy", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY")
PATH = "/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
APART = ("setpriv", "--pdeathsig", "KILL", "unshare", "--mount", "--pid", "--fork", "--kill-child")


class CannotRun(Exception):
    """It cannot be tried here; the text says why and what to do."""


def what_is_missing(folder: Path) -> list[str]:
    """What keeps this machine from running it, each with what to do."""
    found: list[str] = []
    if platform.machine() != "x86_64":
        found.append(
            f"This machine is {platform.machine()}; arm64 is compared with x86-64. On a machine "
            "that is 64-bit ARM itself run: make test"
        )
    if os.geteuid() != 0:
        found.append("Making a Debian in a folder needs root: sudo make arm64")
    packages = {"debootstrap": "debootstrap", "unshare": "util-linux", "setpriv": "util-linux"}
    for program, package in packages.items():
        if shutil.which(program, path=PATH) is None:
            found.append(f"{program} is not installed: sudo apt install {package}")
    if not KEYRING.exists():
        found.append(
            "Debian's keys, which its packages are checked with, are not installed: "
            "sudo apt install debian-archive-keyring"
        )
    problem = emulator_problem(EMULATOR)
    if problem is not None:
        found.append(problem)
    is_there = next(one for one in (folder, *folder.parents) if one.exists())
    free_gb = shutil.disk_usage(is_there).free / 1e9
    if not (folder / "root").exists() and free_gb < FREE_GB:
        found.append(
            f"Only {free_gb:.1f} GB are free on the disk of {folder}; {FREE_GB} are needed. "
            "Free some, or name a folder on another disk: --folder"
        )
    return found


def emulator_problem(entry: Path) -> str | None:
    """Why the kernel does not run programs for arm64, and what to do; None if it does.

    Args:
        entry: the file in which it describes the emulator.
    """
    if not entry.exists():
        return (
            "The kernel does not know how to run programs for arm64: sudo apt install "
            "qemu-user-static binfmt-support\n  If they are installed, as in a container: sudo "
            f"mount -t binfmt_misc none {EMULATOR.parent}; sudo update-binfmts --enable "
            f"{EMULATOR.name}"
        )
    lines = entry.read_text().splitlines()
    if lines[:1] != ["enabled"]:
        return f"The emulator is switched off: sudo update-binfmts --enable {EMULATOR.name}"
    flags = next((line.removeprefix("flags:") for line in lines if line.startswith("flags:")), "")
    if "F" not in flags:
        return (
            "The emulator is registered without the flag F, so it is not found from within the "
            "root: sudo apt install qemu-user-static, which registers a static one with it"
        )
    return None


def mirror_of(targets: str) -> str:
    """The mirror of Debian among apt's sources.

    Args:
        targets: lines `address origin label`, as apt-get writes them.

    Raises:
        CannotRun: There is none.
    """
    for line in targets.splitlines():
        address, *names = line.split()
        if names == ["Debian", "Debian"]:
            return address
    raise CannotRun(
        "None of apt's sources is a mirror of Debian (or `apt update` has not run yet): name one "
        "with --mirror http://..."
    )


def own_mirror() -> str:
    """The mirror that this machine's apt uses.

    Raises:
        CannotRun: It uses none.
    """
    form = "$(REPO_URI) $(ORIGIN) $(LABEL)"
    command = ["apt-get", "indextargets", "--format", form, "Created-By: Packages"]
    try:
        told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        told = ""
    return mirror_of(told)


def pip_environment(settings: Iterable[str]) -> dict[str, str]:
    """This machine's way to the packages as environment variables.

    Args:
        settings: lines of `pip config list`. Folders of this machine are left out.
    """
    found: dict[str, str] = {}
    for line in settings:
        key, _, value = line.partition("=")
        name = key.rpartition(".")[2]
        words = [one for one in value.strip("'\"").split() if not one.startswith(("file:", "/"))]
        if name in PIP_SETTINGS and words:
            found["PIP_" + name.upper().replace("-", "_")] = " ".join(words)
    return found


def network_environment() -> dict[str, str]:
    """What programs in the root have to know to reach packages as this machine does."""
    pip = [sys.executable, "-m", "pip", "config", "list"]
    settings = subprocess.run(pip, capture_output=True, text=True, check=True).stdout
    passed_on = {name: value for name, value in os.environ.items() if name in PROXIES}
    own = {name: value for name, value in os.environ.items() if name.startswith("UV_INDEX")}
    certificates = {"PIP_CERT": CERTIFICATES, "SSL_CERT_FILE": CERTIFICATES}
    return {**pip_environment(settings.splitlines()), **passed_on, **own, **certificates}


@contextmanager
def only_run(folder: Path) -> Iterator[None]:
    """Make the folder, and keep other runs out of it meanwhile.

    Raises:
        CannotRun: Another run uses it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise CannotRun(f"Another run uses {folder}; wait for it, or use --folder") from error
        yield


class Debian:
    """The root in a folder.

    Args:
        folder: where it is kept, with the logs of what ran in it.
    """

    def __init__(self, folder: Path) -> None:
        """Nothing is made yet."""
        self.path = folder / "root"
        self._folder = folder

    def log_of(self, step: str) -> Path:
        """Where the output of a step goes."""
        return self._folder / f"{step}.log"

    def make(self, mirror: str | None) -> bool:
        """Make the root; whether it was not there yet.

        What an interrupted run has left is removed, but not the packages that it has fetched.

        Raises:
            CannotRun: There is no mirror.
            subprocess.CalledProcessError: debootstrap failed; its log says why.
        """
        is_new = not self.path.exists()
        if is_new:
            mirror = mirror or own_mirror()
            unfinished, packages = self._folder / "unfinished", self._folder / "packages"
            shutil.rmtree(unfinished, ignore_errors=True)
            packages.mkdir(exist_ok=True)
            command = ["debootstrap", "--arch=arm64", "--variant=minbase", f"--include={PACKAGES}",
                       f"--cache-dir={packages}", f"--keyring={KEYRING}",
                       RELEASE, str(unfinished), mirror]  # fmt: skip
            with self.log_of("root").open("w") as log:
                subprocess.run(
                    [*APART, "--mount-proc", *command], env={**os.environ, "PATH": PATH},
                    stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, check=True,
                )  # fmt: skip
            unfinished.rename(self.path)
        return is_new

    def use_network(self) -> None:
        """Let it resolve names and trust authorities as this machine does."""
        trusted = os.environ.get("SSL_CERT_FILE") or ssl.get_default_verify_paths().cafile
        for source, target in (("/etc/resolv.conf", "/etc/resolv.conf"), (trusted, CERTIFICATES)):
            if source is not None and Path(source).exists():
                shutil.copy(source, self.path / target.lstrip("/"))

    def run(
        self, command: Sequence[str], log: Path, environment: Mapping[str, str], folder: str
    ) -> int:
        """Run a program in it and wait for its end; its exit code.

        Args:
            command: the program and its arguments.
            log: where its output goes.
            environment: more variables.
            folder: of the root, in which it runs.
        """
        mounts = (
            'mount --rbind /dev "$1/dev" && mount -t proc proc "$1/proc" && '
            'mount --bind "$2" "$1/proc/cpuinfo" && '
            'exec chroot "$1" /usr/bin/env --chdir="$3" "${@:4}"'
        )
        variables = {
            "PATH": PATH,
            "HOME": "/root",
            "LC_ALL": "C.UTF-8",
            "QEMU_CPU": PROCESSOR,
            **environment,
        }
        cpuinfo = self._folder / "cpuinfo"
        cpuinfo.write_text(CPUINFO)
        places = (str(self.path), str(cpuinfo), folder)
        with log.open("w") as out:
            return subprocess.run(
                [*APART, "bash", "-c", mounts, "bash", *places, *command],
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                check=False,
            ).returncode
