"""Memory that a service gives back once it has started."""

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
from trolley.gridmap import distance_transform
from trolley.runtime.memory import give_back
import numpy as np

def resident_kb():
    is_compiler, total = False, 0
    for line in open("/proc/self/smaps"):
        words = line.split()
        if "-" in words[0] and not words[0].endswith(":"):
            is_compiler = "libllvmlite" in line
        elif is_compiler and words[0] == "Rss:":
            total += int(words[1])
    return total

cells = np.zeros((8, 8), bool)
cells[4, 6] = True
before, first = resident_kb(), distance_transform(cells, 0.05)
give_back()
after = resident_kb()
assert after < 0.6 * before, (before, after)
from trolley.jit import kernel

@kernel
def doubled(x):
    return 2.0 * x

assert doubled(3.0) == 6.0  # compiled by what was given back
assert np.array_equal(distance_transform(cells, 0.05), first)
"""


@pytest.mark.programs
def test_a_kernel_can_still_be_compiled_after_the_compiler_was_given_back(tmp_path: Path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    subprocess.run([sys.executable, str(program)], check=True, timeout=100.0)
