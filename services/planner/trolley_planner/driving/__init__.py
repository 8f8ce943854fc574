"""Driving to one goal: route, final approach, progress and recovery."""
