"""The table of faults in docs/faults.md, from what the last runs of `bench.faults` found."""

import os
import platform
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import msgspec
from bench.faults.cases import Outcome
from bench.harness.paths import DOCS, OUT

PAGE = DOCS / "faults.md"
KEPT = OUT / "faults"
BEGIN, END = "<!-- table: python -m bench.faults --write -->", "<!-- end of table -->"
HEADS = ("Fault", "What happens", "Stopped after", "Drives again after", "Lost", "As required")


def keep_outcomes(group: str, outcomes: Sequence[Outcome]) -> None:
    """Save what a group found, until it is tried again."""
    KEPT.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    kept = {"day": date.today().isoformat(), "load": load, "outcomes": list(outcomes)}  # noqa: DTZ011
    (KEPT / f"{group}.json").write_bytes(msgspec.json.encode(kept))


def write_page(groups: Sequence[str]) -> None:
    """Write the table of all groups that were tried."""
    rows: list[str] = []
    loads: list[float] = []
    days: list[str] = []
    for group in groups:
        file = KEPT / f"{group}.json"
        if not file.exists():
            continue
        kept = msgspec.json.decode(file.read_bytes())
        loads.append(kept["load"])
        days.append(kept["day"])
        for one in msgspec.convert(kept["outcomes"], list[Outcome]):
            cells = [*one.cells[:-1], "yes" if not (one.wrong or one.lost) else one.cells[-1]]
            rows.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    words = (
        f"Measured {max(days)} on {os.cpu_count()} cores ({platform.machine()}), at a load of "
        f"{min(loads):.0f} to {max(loads):.0f}, including the load that the faults cause."
    )
    head = "| " + " | ".join(HEADS) + " |\n" + "|---" * len(HEADS) + "|"
    put_between(PAGE, f"{words}\n\n{head}\n" + "\n".join(rows), BEGIN, END)


def put_between(page: Path, text: str, begin: str, end: str) -> None:
    """Replace the text between two lines of a page."""
    old = page.read_text(encoding="utf-8")
    head, _, rest = old.partition(begin)
    _, _, tail = rest.partition(end)
    page.write_text(f"{head}{begin}\n\n{text}\n\n{end}{tail}", encoding="utf-8")
