"""`python -m trolley_base --config robot.toml`."""

from trolley.start import service

if __name__ == "__main__":
    service("trolley_base.service", "BaseService")
