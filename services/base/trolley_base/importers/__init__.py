"""Imports other systems' settings of a robot into `robot.toml`."""
