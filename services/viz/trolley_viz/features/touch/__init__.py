"""What is touched on the map, and its card."""
