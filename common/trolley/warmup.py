"""Compile every kernel once: `python -m trolley.warmup`, part of `make setup`.

Each service with kernels has a module `<package>.warmup` with a function `warm_up()` that calls
them with the kinds of arguments that the service uses. Those of `trolley` itself are called here.
"""

import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trolley.start import program

SERVICES = "trolley.services"
MOST_MB = 400
"""A process that has more resident memory begins anew. Each kernel that is compiled leaves
some behind, and all of them take more than a Raspberry Pi with 1 GB has."""
MOST_RUNS = 50
"""So often at most, should a kernel ever not be found again on the disk."""


class Progress(NamedTuple):
    """What a process that begins anew hands on to the next."""

    part: int = 1
    """The number of the part that it is at."""
    part_s: float = 0.0
    started_s: float = 0.0
    """When the part and the whole were begun (monotonic [s]); 0: not yet."""
    run: int = 1


def warm_up() -> None:
    """Compile the kernels of `trolley.gridmap`."""
    from trolley.gridmap import cast_rays, distance_transform

    occupied = np.zeros((8, 8), dtype=np.bool_)
    occupied[4, 6] = True
    distance_transform(occupied, 0.05)
    cast_rays(occupied, 0.05, (0.1, 0.1), np.zeros(3), 1.0)


def warm_ups() -> dict[str, Callable[[], None]]:
    """What there is to compile, by who needs it: `trolley` itself and every installed service."""
    found: dict[str, Callable[[], None]] = {"common": warm_up}
    for entry in sorted(entry_points(group=SERVICES), key=lambda entry: entry.name):
        package = entry.module.partition(".")[0]
        # A service without kernels has no such module.
        if importlib.util.find_spec(f"{package}.warmup") is not None:
            found[entry.name] = importlib.import_module(f"{package}.warmup").warm_up
    return found


def nothing_is_compiled() -> bool:
    """Whether the services were just installed: no kernel of any of them is kept beside its source.

    Where kernels are kept elsewhere (`NUMBA_CACHE_DIR`, or the source is read-only) nobody looks.
    """
    if os.environ.get("NUMBA_CACHE_DIR") or importlib.util.find_spec("numba") is None:
        return False
    packages = {entry.module.partition(".")[0] for entry in entry_points(group=SERVICES)}
    specs = [importlib.util.find_spec(f"{package}.warmup") for package in sorted(packages)]
    folders = [Path(spec.origin).parent for spec in specs if spec is not None and spec.origin]
    return bool(folders) and not any(
        not os.access(folder, os.W_OK) or any(folder.rglob("__pycache__/*.nbc"))
        for folder in folders
    )


def dots(begin_anew: Callable[[], None]) -> AbstractContextManager[object]:
    """Say a dot for each kernel that is compiled: a small computer takes minutes for a part.

    A kernel that is read from disk is not an event for numba.

    Args:
        begin_anew: Called before one more kernel is compiled, where the process has grown large.
    """
    from trolley.jit import is_kept

    events: Any = importlib.import_module("numba.core.event")

    class Dots(events.Listener):
        last: Any = None
        """What was compiled last of what is kept: numba's own functions never are."""

        def on_start(self, event: Any) -> None:
            if _resident_mb() > MOST_MB and is_kept(self.last):  # not where the disk is full
                begin_anew()

        def on_end(self, event: Any) -> None:
            compiled = event.data["dispatcher"]
            if is_kept(compiled) is not None:
                self.last = compiled
            _say(".")

    return events.install_listener("numba:compile", Dots())


def main(progress: Progress, begin_anew: Callable[[Progress], None]) -> None:
    """Compile everything, a line for each part.

    Args:
        progress: How far the process before came.
        begin_anew: Goes on in a new process.
    """
    if importlib.util.find_spec("numba") is None:
        _say("numba is not installed here: no kernels to compile.\n")
        return
    progress = progress._replace(started_s=progress.started_s or time.monotonic())
    parts = list(warm_ups().items())

    def go_on() -> None:
        if progress.run < MOST_RUNS:
            begin_anew(progress._replace(run=progress.run + 1))

    with dots(go_on):
        for number, (name, compile_all) in enumerate(parts[progress.part - 1 :], progress.part):
            if number > progress.part or not progress.part_s:
                progress = progress._replace(part=number, part_s=time.monotonic())
                _say(f"[{number}/{len(parts)}] {name} ...")
            compile_all()
            _say(f" {time.monotonic() - progress.part_s:.1f} s\n")
    _say(f"All kernels are compiled ({time.monotonic() - progress.started_s:.1f} s).\n")


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _begin_anew(progress: Progress) -> None:
    """Become a new process, which reads from disk what is compiled."""
    arguments = [str(value) for value in progress]
    os.execv(sys.executable, program("trolley.warmup", *arguments))


def _say(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


if __name__ == "__main__":
    part, part_s, started_s, run = sys.argv[1:] or Progress()
    main(Progress(int(part), float(part_s), float(started_s), int(run)), _begin_anew)
