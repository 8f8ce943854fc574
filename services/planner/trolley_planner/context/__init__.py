"""What the planner plans with: costmaps, planners and the robot's motion."""
