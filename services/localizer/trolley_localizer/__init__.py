"""The localizer service: where the robot is on its map."""
