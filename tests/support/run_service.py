"""Run any service class as a process: `python -m support.run_service module:Class`."""

import importlib
import sys

from trolley.runtime.process import main

if __name__ == "__main__":
    module, _, name = sys.argv[1].partition(":")
    main(getattr(importlib.import_module(module), name), sys.argv[2:])
