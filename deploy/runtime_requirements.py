"""Print what Trolley needs to run: its members' requirements, each as requirements.lock pins it.

python3 deploy/runtime_requirements.py   (nothing but Python itself is needed)

With this as the requirements and the whole lock as constraints, `uv` installs what services need,
by version and hash, and none of the developers' tools.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NAME = re.compile(r"[A-Za-z0-9_.-]+")


def wanted(root: Path) -> set[str]:
    """The names of all packages that members ask for, extras and build backend included."""
    names: set[str] = set()
    for path in [root / "common/pyproject.toml", *root.glob("services/*/pyproject.toml")]:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        lists = [
            table["build-system"]["requires"],
            table["project"].get("dependencies", []),
            *table["project"].get("optional-dependencies", {}).values(),
        ]
        found = (NAME.match(requirement) for one in lists for requirement in one)
        names |= {match.group().lower() for match in found if match}
    return {name for name in names if not name.startswith("trolley-robot")}


def pinned(lock: str, names: set[str]) -> list[str]:
    """The entries of a lock file for some names, with their hashes."""
    entries = re.split(r"\n(?! )", lock.strip())
    missing = sorted(names - {entry.partition("==")[0] for entry in entries})
    if missing:
        raise SystemExit(f"requirements.lock lacks {', '.join(missing)}: run `make lock`")
    # A package may have several entries, each for some versions of Python.
    return [entry for entry in entries if entry.partition("==")[0] in names]


if __name__ == "__main__":
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    sys.stdout.write("\n".join(pinned(text, wanted(ROOT))) + "\n")
