"""Tours: made, started and followed."""
