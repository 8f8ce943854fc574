"""A runtime in lock-step, and messages to play with."""

from collections.abc import Generator

import pytest

from trolley.runtime.lockstep import Lockstep


@pytest.fixture
def lockstep() -> Generator[Lockstep]:
    """An empty lock-step runtime for the robot `trolley`."""
    with Lockstep() as runtime:
        yield runtime
