"""Hybrid A*: a search over poses with the true footprint, forwards, backwards and on the spot."""
