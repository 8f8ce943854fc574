"""Changing the map itself: erase, draw walls, turn, crop, merge; shown before it is stored."""
