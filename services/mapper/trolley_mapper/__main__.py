"""Run the mapper as a process: `python -m trolley_mapper --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_mapper.service", "MapperService")
