"""The planner service: drives to goals around obstacles."""
