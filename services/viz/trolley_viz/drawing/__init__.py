"""Drawing zones on the map: the geometry, the board in one browser, and the wishes to the robot."""
