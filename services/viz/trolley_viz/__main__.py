"""Run the viewer: `python -m trolley_viz --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_viz.service", "VizService")
