"""Reads what other systems know of a robot into `robot.toml`."""
