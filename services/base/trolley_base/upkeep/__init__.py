"""Whether wheels and lidar still are as robot.toml says: what stretches of a drive tell."""
