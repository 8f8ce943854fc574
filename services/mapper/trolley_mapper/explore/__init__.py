"""Exploring: which frontier to drive to next, until the map is complete."""
