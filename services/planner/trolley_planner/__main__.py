"""Run the planner as a process: `python -m trolley_planner --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_planner.service", "PlannerService")
