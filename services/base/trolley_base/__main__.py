"""`python -m trolley_base --config robot.toml`."""

from trolley.runtime.process import main
from trolley_base.service import BaseService

if __name__ == "__main__":
    main(BaseService)
