"""The table of faults in docs/faults.md, from what the last runs of `bench.faults` found."""

import os
import platform
import re
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
    """Write what the groups found in place of the rows of the same faults; others stay."""
    old = _between(PAGE)
    rows = {line.split(" | ")[0]: line for line in old.splitlines() if line.startswith("| ")}
    rows.pop(f"| {HEADS[0]}", None)
    days = [*map(date.fromisoformat, re.findall(r"\d{4}-\d\d-\d\d", old))]
    loads = [float(load) for pair in re.findall(r"load of (\d+) to (\d+)", old) for load in pair]
    for group in groups:
        file = KEPT / f"{group}.json"
        if not file.exists():
            continue
        kept = msgspec.json.decode(file.read_bytes())
        loads.append(kept["load"])
        days.append(date.fromisoformat(kept["day"]))
        for one in msgspec.convert(kept["outcomes"], list[Outcome]):
            cells = [*one.cells[:-1], "yes" if not (one.wrong or one.lost) else one.cells[-1]]
            row = "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |"
            rows[row.split(" | ")[0]] = row
    span = " to ".join(map(str, sorted({min(days), max(days)})))
    words = (
        f"Measured {span} on {os.cpu_count()} cores ({platform.machine()}), at "
        f"a load of {min(loads):.0f} to {max(loads):.0f}, including the load that the faults cause."
    )
    head = "| " + " | ".join(HEADS) + " |\n" + "|---" * len(HEADS) + "|"
    put_between(PAGE, f"{words}\n\n{head}\n" + "\n".join(rows.values()), BEGIN, END)


def _between(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]


def put_between(page: Path, text: str, begin: str, end: str) -> None:
    """Replace the text between two lines of a page."""
    old = page.read_text(encoding="utf-8")
    head, _, rest = old.partition(begin)
    _, _, tail = rest.partition(end)
    page.write_text(f"{head}{begin}\n\n{text}\n\n{end}{tail}", encoding="utf-8")
