"""The saved data, and what of it was lost."""

import sqlite3
import tomllib
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# What a person saved: it must stay as it was, byte for byte.
KEPT = (
    "poses.toml",
    "tours.toml",
    "zones/apartment.toml",
    "map.toml",
    "viewer.toml",
)
# What changes while the robot drives: it must be readable.
CHANGING = ("base_time.toml", "last_pose.toml", "trip.toml", "base_stop.toml")
HISTORY = "history.sqlite"


@dataclass(frozen=True)
class Saved:
    """The content of a robot's state folder."""

    kept: dict[str, bytes]
    changing: dict[str, dict[str, Any]]
    trips: frozenset[str]
    broken: tuple[str, ...]
    """Files that were set aside, or that cannot be read."""


def read_saved(state: Path, robot: str) -> Saved:
    """Read a state folder without touching it."""
    folder = state / robot
    kept = {name: (folder / name).read_bytes() for name in KEPT if (folder / name).exists()}
    changing: dict[str, dict[str, Any]] = {}
    broken = [str(path.relative_to(state)) for path in state.rglob("*.broken-*")]
    for name in CHANGING:
        try:
            changing[name] = tomllib.loads((folder / name).read_text())
        except FileNotFoundError:
            continue
        except ValueError:
            broken.append(name)
    trips: frozenset[str] = frozenset()
    if (folder / HISTORY).exists():
        with closing(sqlite3.connect(f"file:{folder / HISTORY}?mode=ro", uri=True)) as history:
            rows = history.execute("SELECT trip, state FROM trips")
            trips = frozenset(f"{trip} {state}" for trip, state in rows)
    return Saved(kept, changing, trips, tuple(broken))


def lost(before: Saved, after: Saved) -> list[str]:
    """What was there and is gone or changed."""
    found = [
        f"{name} has changed" for name in before.kept if after.kept.get(name) != before.kept[name]
    ]
    found += [f"{name} is gone" for name in before.changing if name not in after.changing]
    found += [f"{trip} is gone from the history" for trip in before.trips - after.trips]
    found += [f"{name} is broken" for name in after.broken if name not in before.broken]
    earlier, later = (
        saved.changing.get("base_time.toml", {}).get("stamp_ns", 0) for saved in (before, after)
    )
    if later < earlier:
        found.append("robot time went back")
    return found
