"""Changing stored maps, and letting the robot switch to what has changed."""
