"""Who has the viewer open, and who is let in."""
