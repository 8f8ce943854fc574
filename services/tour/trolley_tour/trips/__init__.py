"""Trips: the tour that is driven, what became of it, and what starts it."""
