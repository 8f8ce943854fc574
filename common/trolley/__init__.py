"""Trolley: navigation for small indoor robots, without ROS."""
