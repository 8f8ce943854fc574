"""Checks a robot.toml: `python -m trolley.config FILE`, as the installer does before an upgrade."""

import sys
from pathlib import Path

from trolley.config.load import ConfigError, load_config
from trolley.sanitize import fit


def main() -> int:
    """Say why it cannot be used; the exit code."""
    try:
        load_config(Path(sys.argv[1]))
    except ConfigError as error:
        sys.stderr.write(fit(f"{error}\n", sys.stderr.encoding))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
