"""Run the localizer as a process: `python -m trolley_localizer --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_localizer.service", "LocalizerService")
