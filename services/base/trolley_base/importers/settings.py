"""Settings that several systems have: the footprint, and the map of `map_server`."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from trolley.geometry import footprint_from_polygon, footprint_from_radius
from trolley.gridmap import MapError, load_map
from trolley.yaml_loader import FewReferencesLoader
from trolley_base.importers.findings import Findings, Value

SAME_M = 1e-6
"""A centred box is recognised up to this [m]."""


def take_footprint(findings: Findings, given: Value | None) -> None:
    """Take a costmap's `footprint` or `robot_radius`."""
    if given is not None:
        try:
            value, words = _footprint(given.value)
        except (TypeError, ValueError, yaml.YAMLError) as error:
            findings.note(f"{findings.place(given)}: the footprint cannot be used: {error}.")
        else:
            findings.take("robot.footprint", value, words, given)
            return
    findings.note(
        "No footprint was found: the file now says 0.30 x 0.24 m. Measure the robot and correct "
        "[robot] footprint before it drives."
    )


def _footprint(value: object) -> tuple[dict[str, Any], str]:
    """Return a footprint in the terms of `robot.toml`, and in words.

    Raises:
        TypeError: it is none.
        ValueError: it is none, or makes no robot; says why.
    """
    plain: Any = yaml.load(value, FewReferencesLoader) if isinstance(value, str) else value
    if isinstance(plain, int | float) and not isinstance(plain, bool):
        footprint_from_radius(plain)
        return {"radius_m": float(plain)}, f"footprint with a radius of {plain:g} m"
    try:
        corners = np.asarray(plain, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{plain!r:.80} holds something other than numbers") from error
    footprint_from_polygon(corners)
    half = np.abs(corners).max(axis=0)
    if len(corners) == 4 and np.all(np.abs(np.abs(corners) - half) < SAME_M):
        length, width = (round(2.0 * float(side), 6) for side in half)
        return {"length_m": length, "width_m": width}, f"footprint {length:g} x {width:g} m"
    return {"polygon_m": corners.tolist()}, f"footprint with {len(corners)} corners"


def take_map(findings: Findings, source: Value) -> None:
    """Take the map whose file is the value of `source`, if it is one."""
    path: Path = source.value
    try:
        grid = load_map(path)
    except MapError as error:
        findings.note(f"{findings.place(source)}: no map is taken: {error}.")
        return
    findings.map_file = path
    rows, columns = grid.cells.shape
    size = f"{columns * grid.resolution:.1f} x {rows * grid.resolution:.1f} m"
    findings.take("map.file", f"maps/{path.name}", f"map {path.stem}, {size}", source)
