"""The people at the open pages: what their browsers are called, who is there, who did what."""
