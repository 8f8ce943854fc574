"""Where things lie in the repository, whatever folder a program is started from."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORLDS = ROOT / "worlds"
DOCS = ROOT / "docs"
OUT = ROOT / "out"
"""Pictures and readings that the programs leave; git ignores it."""
