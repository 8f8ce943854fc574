"""A trial in a process of its own: can each service use robot.toml, and is its code compiled?

Making a service reads its settings closely (the world file, the lidar's mode) and loads the
compiler, so it stays out of the process that asks. No device is opened: that is for the service's
start.
"""

import dataclasses
import importlib
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, cast

from trolley.config import ConfigError
from trolley.config.kept_settings import load_with_kept
from trolley.doctor.finding import Finding, note, ok, problem, warning
from trolley.doctor.users import User
from trolley.runtime.state import state_root
from trolley.start import program
from trolley.supervision import PARENT_VARIABLE, end_with_parent

SERVICES = "trolley.services"
MARK = "from trolley.jit import"
"""What a module begins a line with that makes kernels."""
PATIENCE_S = 90.0
"""A Raspberry Pi takes some time to load the compiler."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """How it went."""

    refused: Mapping[str, str]
    """Why a service cannot use the settings, by its name."""
    tried: tuple[str, ...]
    kernels: int = 0
    """How many functions are compiled to machine code."""
    missing: int = 0
    """How many of them are not compiled yet."""
    trouble: str = ""
    """Why nothing can be told."""


class Running:
    """A trial that is under way; it is looked at when it has had some time.

    Args:
        config: the robot.toml to try, None for none.
        environment: what the services have in their environment.
        user: as whom, for root to say; None: as whoever asks. The compiler makes folders for what
            it keeps, which must not be root's.
    """

    def __init__(
        self, config: Path | None, environment: Mapping[str, str], user: User | None = None
    ) -> None:
        words = program("trolley.doctor.trial", *([str(config)] if config else []))
        self._process: subprocess.Popen[bytes] | None = None
        self._trouble = ""
        try:
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env={**os.environ, **environment, PARENT_VARIABLE: str(os.getpid())},
                user=None if user is None else user.uid,
                group=None if user is None else user.group,
                extra_groups=None if user is None else sorted(user.groups),
            )
        except OSError as error:  # such as: that user may not read where Trolley is installed
            who = "" if user is None else f" as {user.name}"
            self._trouble = f"it cannot be started{who}: {error.strerror}"

    def outcome(self) -> Trial:
        """Wait for its end."""
        if self._process is None:
            return Trial({}, (), trouble=self._trouble)
        try:
            said, errors = self._process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            return Trial({}, (), trouble=f"it took over {PATIENCE_S:g} s")
        if self._process.returncode != 0:
            lines = errors.decode("utf-8", "replace").strip().splitlines()
            return Trial({}, (), trouble=lines[-1] if lines else "it ended without a message")
        plain = cast("dict[str, Any]", json.loads(said))
        return Trial(plain["refused"], tuple(plain["tried"]), plain["kernels"], plain["missing"])

    def end(self) -> None:
        """End it, where nobody wants to know any more."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


def check_trial(trial: Trial) -> list[Finding]:
    """Whether the services would start, and at once."""
    if trial.trouble:
        return [
            note(
                "settings",
                f"Whether the services can use the settings could not be tested: {trial.trouble}.",
                "`trolley run base` shows more.",
            )
        ]
    found = [
        problem(
            "settings",
            f"{service} cannot use robot.toml: {why}.",
            "Correct that; docs/configuration.md lists every key.",
        )
        for service, why in trial.refused.items()
    ]
    if trial.tried and not found:
        found.append(ok("settings", f"{', '.join(trial.tried)} can use robot.toml."))
    if trial.missing:
        found.append(
            warning(
                "kernels",
                f"{trial.missing} of {trial.kernels} functions are not compiled for this "
                "computer yet, so the first start takes long.",
                "`python -m trolley.warmup` with the Python that Trolley is installed in, as the "
                "user of the services.",
            )
        )
    elif trial.kernels:
        found.append(ok("kernels", f"All {trial.kernels} functions are compiled."))
    return found


def try_services(path: Path) -> dict[str, str]:
    """Make each installed service that these settings are for; why not, "" where it can be made."""
    try:
        config = load_with_kept(path, state_root()).config
    except ConfigError:  # said by another check, with all that is wrong
        return {}
    tried: dict[str, str] = {}
    for entry in entry_points(group=SERVICES):
        if entry.name in config.idle_services:
            continue
        try:
            entry.load()(config)
        except ConfigError as error:
            tried[entry.name] = str(error)
        else:
            tried[entry.name] = ""
    return tried


def main() -> None:
    """Try, and print the outcome as JSON."""
    end_with_parent()
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    outcomes = {} if path is None else try_services(path)
    refused = {name: why for name, why in outcomes.items() if why}
    kernels, missing = count_kernels()
    plain = {
        "refused": refused,
        "tried": sorted(outcomes),
        "kernels": kernels,
        "missing": missing,
    }
    sys.stdout.write(json.dumps(plain))


def count_kernels() -> tuple[int, int]:
    """How many kernels the installed packages have, and how many are not kept on disk."""
    if importlib.util.find_spec("numba") is None:
        return 0, 0
    from trolley.jit import is_kept

    kernels = missing = 0
    for module in map(importlib.import_module, _modules_with_kernels()):
        for value in vars(module).values():
            is_own = getattr(value, "__module__", None) == module.__name__
            kept = is_kept(value) if is_own else None
            if kept is not None:
                kernels += 1
                missing += not kept
    return kernels, missing


def _modules_with_kernels() -> Iterator[str]:
    """Names of the installed modules that make kernels."""
    packages = ["trolley", *(one.module.partition(".")[0] for one in entry_points(group=SERVICES))]
    for package in packages:
        spec = importlib.util.find_spec(package)
        for place in (spec.submodule_search_locations or []) if spec else []:
            for file in sorted(Path(place).rglob("*.py")):
                if any(line.startswith(MARK) for line in file.read_text("utf-8").splitlines()):
                    inside = file.relative_to(place).with_suffix("").parts
                    yield ".".join((package, *(part for part in inside if part != "__init__")))


if __name__ == "__main__":
    main()
