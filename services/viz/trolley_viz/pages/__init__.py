"""Open pages: each hears what its person presses and is told what is."""
