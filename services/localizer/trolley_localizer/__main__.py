"""Run the localizer as a process: `python -m trolley_localizer --config robot.toml`."""

from trolley.runtime.process import main
from trolley_localizer.service import LocalizerService

if __name__ == "__main__":
    main(LocalizerService)
