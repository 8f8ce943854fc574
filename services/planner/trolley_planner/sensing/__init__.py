"""What the planner is told by the rest of the robot: messages, and the beams of a scan."""
