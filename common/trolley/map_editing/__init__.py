"""Changing a stored map: erase, draw walls, turn, crop, merge with another map.

Plain functions from a grid to a new grid, in NumPy alone, so that a viewer shows with them what the
mapper will store. They refuse what makes no sense and leave their inputs as they are.
"""

from trolley.map_editing.apply import apply, merge
from trolley.map_editing.straight import angle_of_walls, angle_to_straighten

__all__ = ["angle_of_walls", "angle_to_straighten", "apply", "merge"]
