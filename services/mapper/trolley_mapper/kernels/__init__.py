"""Compiled loops of the mapper: arrays and scalars only."""
