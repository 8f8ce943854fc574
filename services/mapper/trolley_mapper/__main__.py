"""Run the mapper as a process: `python -m trolley_mapper --config robot.toml`."""

from trolley.runtime.process import main
from trolley_mapper.service import MapperService

if __name__ == "__main__":
    main(MapperService)
