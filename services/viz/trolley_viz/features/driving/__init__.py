"""Sending the robot somewhere, and telling it where it is."""
