"""Checks a robot.toml: `python -m trolley.config FILE`, as the installer does before an upgrade."""

import sys
from pathlib import Path

from trolley.config.load import ConfigError, load_config
from trolley.sanitize import fit

if __name__ == "__main__":
    try:
        load_config(Path(sys.argv[1]))
    except ConfigError as error:
        sys.exit(fit(str(error), sys.stderr.encoding))
