"""One open browser: what it shows, what its person may do, and what it remembers."""
