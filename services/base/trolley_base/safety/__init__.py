"""What may be driven: the arbiter, the limits, the stop field, the emergency stop."""
