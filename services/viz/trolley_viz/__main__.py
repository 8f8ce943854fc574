"""Run the viewer: `python -m trolley_viz --config robot.toml`."""

from trolley.runtime.process import main
from trolley_viz.service import VizService

if __name__ == "__main__":
    main(VizService)
