"""A process without a file left to open."""

import os
import resource
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def no_files_left() -> Generator[None]:
    """Let this process open nothing more while the context lasts."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken = [os.dup(0)]
    resource.setrlimit(resource.RLIMIT_NOFILE, (taken[0] + 20, hard))
    try:
        while True:
            try:
                taken.append(os.dup(0))
            except OSError:
                break
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for file in taken:
            os.close(file)
