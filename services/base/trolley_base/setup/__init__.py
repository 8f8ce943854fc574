"""The robot measures itself: how its lidar sits, how its wheels count, how soon it obeys.

The pure core of `trolley setup`: readings of the devices in, velocities and findings out.
"""
