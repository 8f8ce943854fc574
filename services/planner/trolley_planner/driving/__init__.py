"""Driving to one goal: route, approach and recovery."""
