"""What programs draw into the scene."""
