"""Scan matching, keyframes, loop closures and the pose graph: scans in, poses and a map out."""
