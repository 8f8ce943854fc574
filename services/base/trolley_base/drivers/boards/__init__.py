"""Motor boards by their firmware."""
