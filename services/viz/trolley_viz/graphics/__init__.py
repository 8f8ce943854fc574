"""Shapes, pictures and the camera: geometry without any state of a robot."""
