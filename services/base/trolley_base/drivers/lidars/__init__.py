"""Lidars by their model."""
