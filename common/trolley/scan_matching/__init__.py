"""Scans aligned with the surfaces that earlier ones saw, for the mapper and for odometry."""
