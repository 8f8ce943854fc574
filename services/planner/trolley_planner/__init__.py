"""The planner service: drives to a goal around what is in the way."""
