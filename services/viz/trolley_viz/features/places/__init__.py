"""Saved places."""
