"""Field types that messages share: stamps, finite numbers, names, numeric arrays as bytes."""

from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from trolley.geometry.pose import LARGEST, Finite

StampNs = Annotated[int, Meta(ge=0, le=2**63 - 1)]
"""Robot time [ns]; 0 = the sender has no robot time."""

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
"""A part of the whole, 0 to 1."""

NonNegative = Annotated[float, Meta(ge=0.0, le=LARGEST)]
"""A finite number that is not negative."""

Positive = Annotated[float, Meta(gt=0.0, le=LARGEST)]
"""A finite number above zero."""

Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
"""How many."""

Point = tuple[Finite, Finite]
"""x, y [m]."""

Point3 = tuple[Finite, Finite, Finite]
"""x, y, z [m]."""

Colour = tuple[Share, Share, Share, Share]
"""Red, green, blue, alpha, each 0 to 1."""

Covariance = Annotated[list[Finite], Meta(min_length=9, max_length=9)]
"""3 x 3 row-major over x, y [m] and yaw [rad]."""

MAX_LIST_BYTES = (1 << 20) - 4096
"""Room for what people store of one kind: all of it travels in one message of at most 1 MiB."""


def fit_into_a_message(values: Sequence[Struct]) -> bool:
    """Whether all of these can be published as one list, as msgpack and as JSON.

    Either may be the larger: short numbers are shorter as JSON, names of fields as msgpack.
    """
    sizes = len(msgspec.json.encode(values)), len(msgspec.msgpack.encode(values))
    return max(sizes) <= MAX_LIST_BYTES


def floats_to_bytes(values: NDArray[Any]) -> memoryview:
    """Give `values` as the contract's array bytes: float32, little-endian, C order, any shape."""
    return memoryview(np.ascontiguousarray(values, dtype="<f4").tobytes())


def floats_from_bytes(data: memoryview | bytes, columns: int = 1) -> NDArray[np.float32]:
    """View array bytes as float32, read-only: (N,), or (N, columns) when `columns` > 1."""
    values = np.frombuffer(data, dtype="<f4")
    return values if columns == 1 else values.reshape(-1, columns)


def check_floats(owner: str, field: str, data: memoryview | bytes, columns: int = 1) -> int:
    """Return the number of rows in array bytes.

    Raises:
        ValueError: The length is not a whole number of rows of float32.
    """
    rows, rest = divmod(len(data), 4 * columns)
    if rest:
        raise ValueError(
            f"{owner}.{field}: {len(data)} bytes are not a whole number of {columns} x float32 rows"
        )
    return rows
