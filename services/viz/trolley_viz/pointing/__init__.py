"""Pointing at the map in a browser: gestures, drags, and places on the floor."""
