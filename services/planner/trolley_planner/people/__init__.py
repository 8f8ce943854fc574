"""People and other moving things: who moves, where to, and where they will be."""
