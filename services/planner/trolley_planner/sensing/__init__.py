"""The planner's inputs: newest messages, and the beams of a scan."""
