"""For engineers: frames, numbers, services, streams."""
