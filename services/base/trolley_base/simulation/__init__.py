"""A robot in a simulated world in place of the hardware."""
