"""Where the world differs from the map: what has come or gone, mirrors."""
