"""Whether the pose that is followed is the right one, and what else it may be."""
