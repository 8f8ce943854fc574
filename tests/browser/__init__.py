"""The viewer in a real browser; the tests of a process share one demo."""
