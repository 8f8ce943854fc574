"""Changing the map itself."""
