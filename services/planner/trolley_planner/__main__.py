"""Run the planner as a process: `python -m trolley_planner --config robot.toml`."""

from trolley.runtime.process import main
from trolley_planner.service import PlannerService

if __name__ == "__main__":
    main(PlannerService)
