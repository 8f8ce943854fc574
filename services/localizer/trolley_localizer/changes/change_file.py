"""The file that keeps, map by map, what was seen to have changed."""

import base64
import binascii
import zlib

import numpy as np
from msgspec import Struct

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages.map_changes import ChangeKind
from trolley_localizer.changes.change_detector import MOST_DISMISSED, ChangeDetector, MarkedChange
from trolley_localizer.kernels.changes import COLUMNS

_MOST_BYTES = 1 << 26
"""What a file may unpack to: more than all cells that are ever kept [bytes]."""
_WIDTH = 2 + COLUMNS


class KeptChange(Struct, frozen=True, kw_only=True):
    """A change that was proposed or dismissed: where it is, in rows and columns of the map."""

    id: str
    kind: ChangeKind
    box: tuple[int, int, int, int]


class ChangeFile(Struct, frozen=True, kw_only=True):
    """Evidence for changes of one map; it holds as long as its cells lie where they lay."""

    rows: int
    columns: int
    resolution: float
    origin: Pose2D
    clock_s: float
    next_number: int
    proposed: list[KeptChange] = []
    dismissed: list[KeptChange] = []
    cells: str = ""
    """Row, column and evidence of each cell: int32, packed by zlib, as base64."""

    def __post_init__(self) -> None:
        """Refuse cells that cannot be unpacked."""
        unpack(self.cells)

    def is_of(self, grid: GridMap) -> bool:
        """Say whether the cells of a map lie where they lay."""
        return (self.rows, self.columns) == grid.cells.shape and (
            self.resolution,
            self.origin,
        ) == (grid.resolution, grid.origin)


def state_file(map_name: str) -> str:
    """Return where the evidence on a map lies in the robot's state folder."""
    return f"changes/{map_name}.toml"


def pack(table: np.ndarray[tuple[int, int], np.dtype[np.int32]]) -> str:
    """Return rows of int32 as text."""
    return base64.b64encode(zlib.compress(table.astype("<i4").tobytes())).decode()


def unpack(text: str) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    """Return what `pack` packed.

    Raises:
        ValueError: it is something else.
    """
    try:
        packed = base64.b64decode(text, validate=True)
        plain = zlib.decompressobj().decompress(packed, _MOST_BYTES) if packed else b""
    except (binascii.Error, zlib.error) as error:
        raise ValueError(f"the cells cannot be unpacked: {error}") from error
    if len(plain) % (4 * _WIDTH):
        raise ValueError(f"the cells are not rows of {_WIDTH} numbers")
    return np.frombuffer(plain, "<i4").reshape(-1, _WIDTH).astype(np.int32)


def to_file(changes: ChangeDetector, grid: GridMap) -> ChangeFile:
    """Return what is to be kept."""
    where, rows = changes.change_grid.changed()
    return ChangeFile(
        rows=grid.rows,
        columns=grid.cols,
        resolution=grid.resolution,
        origin=grid.origin,
        clock_s=changes.clock_s,
        next_number=changes.next_number,
        proposed=[_kept(one) for one in changes.named],
        dismissed=[_kept(one) for one in changes.dismissed],
        cells=pack(np.hstack([where.astype(np.int32), rows])),
    )


def from_file(changes: ChangeDetector, file: ChangeFile) -> None:
    """Go on from what was kept."""
    table = unpack(file.cells)
    changes.clock_s = file.clock_s
    changes.next_number = file.next_number
    changes.named = [MarkedChange(one.id, one.kind, one.box) for one in file.proposed]
    changes.dismissed = [
        MarkedChange(one.id, one.kind, one.box) for one in file.dismissed[-MOST_DISMISSED:]
    ]
    changes.change_grid.restore(table[:, :2].astype(np.int64), table[:, 2:])


def _kept(one: MarkedChange) -> KeptChange:
    return KeptChange(id=one.id, kind=one.kind, box=one.box)
