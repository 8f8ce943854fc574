"""Reads a recorded drive from an npz file with odometry and scans.

Fields: `stamps` (n,) [s]; `odom` (n, 3) x, y [m], yaw [rad] as the wheels reported
them, or `odom_signed`, which is preferred; `ranges_mm` (n, beams) unsigned, 65535 = no echo,
0 = invalid;
`angle_min`, `angle_increment` [rad], counter-clockwise; `range_max` [m]. If there: `reference`
(n, 3) map_T_base, and `laser_in_base` x, y [m], yaw [rad].
"""

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.files import open_file
from trolley.geometry import Pose2D
from trolley_base.drivers.interface import DriverError, LidarScan
from trolley_base.recording.recording import Recording

NO_ECHO_MM = 65535
MIN_BEAMS = 2
LONGEST_S = 1e7
"""Longer drives must have stamps in another unit [s]."""


def load_npz(path: Path) -> Recording:
    """Read an npz file.

    Raises:
        DriverError: naming the file, the field, and what is expected there.
    """
    return _recording(_Fields(path, _arrays(path)))


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        # Opened here since numpy leaves a file open that it cannot read. Pickled objects would be
        # code from a stranger; numbers need none.
        with open_file(path) as stream:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise DriverError(f"{path}: not an npz file but a single array; save it with savez")
            with archive:
                return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise DriverError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise DriverError(
            f"{path}: not a recording (an npz file of plain numbers): {error}; record it again"
        ) from error


def _recording(fields: "_Fields") -> Recording:
    stamps = fields.array("stamps", (None,))
    if len(stamps) < 2 or not (np.diff(stamps) > 0.0).all():
        raise fields.refusal("stamps", "must be at least two times in seconds, each later")
    if not stamps[-1] - stamps[0] < LONGEST_S:
        raise fields.refusal("stamps", f"must be in seconds, and span less than {LONGEST_S:.0f} s")
    stamps_ns: NDArray[np.int64] = np.rint((stamps - stamps[0]) * 1e9).astype(np.int64)
    if not (np.diff(stamps_ns) > 0).all():
        raise fields.refusal("stamps", "must be in seconds, at least 1 ns apart")
    rows = len(stamps)
    odom = fields.array("odom_signed" if "odom_signed" in fields else "odom", (rows, 3))
    start = fields.array("reference", (rows, 3))[0] if "reference" in fields else None
    mount = fields.array("laser_in_base", (3,)) if "laser_in_base" in fields else np.zeros(3)
    return Recording(
        stamps_ns=stamps_ns,
        scans=_scans(fields, stamps_ns),
        odom_stamps_ns=stamps_ns,
        odom=odom,
        base_T_laser=Pose2D.from_array(mount),
        map_T_start=None if start is None else Pose2D.from_array(start),
    )


def _scans(fields: "_Fields", stamps_ns: NDArray[np.int64]) -> list[LidarScan]:
    range_max = fields.positive("range_max")
    angle_min = float(fields.array("angle_min", ()))
    angle_increment = fields.positive("angle_increment")
    return [
        LidarScan(
            stamp_ns=int(stamp_ns),
            angle_min=angle_min,
            angle_increment=angle_increment,
            # The files do not say when in a revolution a beam was measured.
            time_increment=0.0,
            range_min=0.0,
            range_max=range_max,
            ranges=ranges,
        )
        for stamp_ns, ranges in zip(
            stamps_ns, _ranges(fields, len(stamps_ns), range_max), strict=True
        )
    ]


def _ranges(fields: "_Fields", rows: int, range_max: float) -> NDArray[np.float32]:
    ranges_mm = fields.raw("ranges_mm")
    if not np.issubdtype(ranges_mm.dtype, np.unsignedinteger):
        raise fields.refusal(
            "ranges_mm", f"must be unsigned whole millimetres (uint16), not {ranges_mm.dtype}"
        )
    if ranges_mm.ndim != 2 or len(ranges_mm) != rows or ranges_mm.shape[1] < MIN_BEAMS:
        raise fields.refusal(
            "ranges_mm", f"must have a row of beams for each of the {rows} stamps, "
            f"not shape {ranges_mm.shape}"
        )  # fmt: skip
    ranges = ranges_mm.astype(np.float32) * np.float32(0.001)
    ranges[(ranges_mm >= NO_ECHO_MM) | (ranges > range_max)] = np.inf
    return ranges


class _Fields:
    """The arrays of a file, with refusals that name file and field."""

    def __init__(self, path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._path = path
        self._arrays = arrays

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def refusal(self, name: str, sentence: str) -> DriverError:
        return DriverError(f"{self._path}: field `{name}` {sentence}")

    def raw(self, name: str) -> NDArray[Any]:
        if name not in self._arrays:
            there = ", ".join(sorted(self._arrays)) or "nothing"
            raise self.refusal(name, f"is missing; the file holds {there}")
        return self._arrays[name]

    def array(self, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
        """Return a field as finite numbers of a shape, where None is any length."""
        array = self.raw(name)
        fits = array.ndim == len(shape) and all(
            wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = tuple("n" if length is None else length for length in shape)
            raise self.refusal(name, f"must have the shape {wanted}, not {array.shape}")
        if not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
            raise self.refusal(name, f"must hold numbers, not {array.dtype}")
        numbers = np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)
        if not np.isfinite(numbers).all():
            raise self.refusal(name, "holds numbers that are not finite; take those rows out")
        return numbers

    def positive(self, name: str) -> float:
        number = float(self.array(name, ()))
        if number <= 0.0:
            raise self.refusal(name, f"must be above zero, not {number}")
        return number
