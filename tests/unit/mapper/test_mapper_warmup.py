"""Nothing is compiled while the robot maps: for so long the service would not turn."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs

# In a process of its own: in that of other tests everything is compiled already.
PROGRAM = """
import gc
from numba.core.registry import CPUDispatcher
from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.warmup import warm_up

def ready():
    every = (one for one in gc.get_objects() if isinstance(one, CPUDispatcher))
    ours = (one for one in every if one.py_func.__module__.startswith("trolley_mapper"))
    return {(one.py_func.__qualname__, str(kind)) for one in ours for kind in one.signatures}

warm_up()
before = ready()
from conftest import START, Drive, make_flat  # which casts rays by a kernel of its own

drive = Drive(make_flat(), Mapper(MapperConfig()))
drive.tour()
drive.pose = Pose2D(6.5, 2.0, 0.3)  # carried off
states = {drive.look().state for _ in range(25)}
states |= {drive.scan(0.2, 0.0).state for _ in range(40)}
drive.mapper.undo(5.0)
extended = Drive(make_flat(), Mapper(MapperConfig(), prior=drive.mapper.grid()))
states |= {extended.look().state for _ in range(25)}
print(sorted(states))
print(sorted(name for name, _ in ready() - before))
"""


def test_no_kernel_is_left_to_be_compiled_while_a_map_is_made() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    states, left = done.stdout.splitlines()
    assert states == "['lost', 'mapping', 'unsure']"
    assert left == "[]"
