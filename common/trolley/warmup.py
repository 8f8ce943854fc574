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
from typing import Any

import numpy as np

SERVICES = "trolley.services"


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


def dots() -> AbstractContextManager[object]:
    """Say a dot for each kernel that is compiled: a small computer takes minutes for a part.

    A kernel that is read from disk is not an event for numba.
    """
    events: Any = importlib.import_module("numba.core.event")

    class Dots(events.Listener):
        def on_start(self, event: Any) -> None:
            pass

        def on_end(self, event: Any) -> None:
            _say(".")

    return events.install_listener("numba:compile", Dots())


def main() -> None:
    """Compile everything, a line for each part."""
    started_s = time.monotonic()
    if importlib.util.find_spec("numba") is None:
        _say("numba is not installed here: no kernels to compile.\n")
        return
    parts = warm_ups()
    for number, (name, compile_all) in enumerate(parts.items(), start=1):
        _say(f"[{number}/{len(parts)}] {name} ...")
        part_s = time.monotonic()
        with dots():
            compile_all()
        _say(f" {time.monotonic() - part_s:.1f} s\n")
    _say(f"All kernels are compiled ({time.monotonic() - started_s:.1f} s).\n")


def _say(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
