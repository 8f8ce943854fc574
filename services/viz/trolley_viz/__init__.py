"""The viewer service: robot, map and trip in a browser."""
