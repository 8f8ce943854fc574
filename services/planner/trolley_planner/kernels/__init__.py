"""Compiled loops of the planner: arrays and scalars in frame `grid`, no I/O."""
