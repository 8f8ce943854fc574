"""The pose that is followed: motion model, particle filter, scan alignment."""
