"""Compiled loops of the localizer: arrays and scalars only, lengths in grid cells."""
