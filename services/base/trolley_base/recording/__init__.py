"""A recorded drive in place of the hardware."""
