"""Drivers of a lidar and a motor board that nobody sells, to copy from."""
