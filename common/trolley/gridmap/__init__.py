"""Occupancy grids: reading, writing, coordinates, distances and rays."""

from trolley.gridmap.grid import FREE, OCCUPIED, OCCUPIED_FROM, UNKNOWN, GridMap

__all__ = ["FREE", "OCCUPIED", "OCCUPIED_FROM", "UNKNOWN", "GridMap"]
