"""Zones: drawn, changed and suspected."""
