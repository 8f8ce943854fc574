"""How a scan and the map are compared, at a pose or on the whole map."""
