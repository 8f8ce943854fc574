"""What all tests share: hypothesis profiles and the folder of recorded drives."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# No deadline: the first call of a numba kernel compiles it.
settings.register_profile("trolley", deadline=None)
settings.register_profile("trolley-ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("trolley-ci" if os.environ.get("CI") else "trolley")


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of recorded drives, named by TROLLEY_DATA; without it the test is skipped."""
    folder = os.environ.get("TROLLEY_DATA", "")
    if not folder:
        pytest.skip("TROLLEY_DATA does not name a folder of recorded drives")
    if not Path(folder).is_dir():
        pytest.skip(f"TROLLEY_DATA names no folder: {folder}")
    return Path(folder)
