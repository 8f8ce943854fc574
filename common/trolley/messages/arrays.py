"""Which fields hold numeric arrays as bytes, and how to read them as numbers."""

import dataclasses
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.messages.driving import Path
from trolley.messages.mapping import OccupancyGrid, ParticleCloud
from trolley.messages.sensing import BeamClasses, Scan


@dataclasses.dataclass(frozen=True)
class ArrayField:
    """The contract's layout of one array: little-endian, C order."""

    dtype: str
    """Type of the elements, as numpy spells it."""
    shape: tuple[str, ...]
    """Lengths for people; a whole number is fixed, a word varies (`width` is that field)."""

    def read(self, data: memoryview | bytes, owner: msgspec.Struct) -> NDArray[Any]:
        """View the bytes as numbers, without a copy."""
        flat = np.frombuffer(data, dtype=self.dtype)
        if len(self.shape) == 1:
            return flat
        columns = self.shape[-1]
        width = int(columns) if columns.isdigit() else cast("int", getattr(owner, columns))
        return flat.reshape(-1, width) if width else flat.reshape(0, 0)


ARRAY_FIELDS: dict[tuple[type[msgspec.Struct], str], ArrayField] = {
    (Scan, "ranges"): ArrayField("<f4", ("N",)),
    (Scan, "intensities"): ArrayField("<f4", ("N or 0",)),
    (BeamClasses, "classes"): ArrayField("|u1", ("N",)),
    (OccupancyGrid, "cells"): ArrayField("|i1", ("height", "width")),
    (ParticleCloud, "poses"): ArrayField("<f4", ("N", "3")),
    (ParticleCloud, "weights"): ArrayField("<f4", ("N",)),
    (Path, "poses"): ArrayField("<f4", ("N", "3")),
}
"""All of them."""


def arrays_of(message: msgspec.Struct) -> dict[str, NDArray[Any]]:
    """The arrays of a message by field name, as numbers."""
    return {
        field: layout.read(getattr(message, field), message)
        for (kind, field), layout in ARRAY_FIELDS.items()
        if kind is type(message)
    }
