"""The goal under way: what is asked of it, what drives to it, what pauses it."""
