"""Run the tour as a process: `python -m trolley_tour --config robot.toml`."""

from trolley.runtime.process import main
from trolley_tour.service import TourService

if __name__ == "__main__":
    main(TourService)
