"""What the rest of the robot reports: newest messages, and the beams of a scan."""
