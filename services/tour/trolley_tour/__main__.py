"""Run the tour as a process: `python -m trolley_tour --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_tour.service", "TourService")
