"""What people do in the page of which viser tells nothing, or too much."""
