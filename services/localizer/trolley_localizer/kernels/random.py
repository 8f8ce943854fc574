"""Random numbers from a counter: the same counter gives the same number, in any order.

numba's `np.random` costs three times as much as the sensor model and shares one state per thread.

Source:
    Steele, Lea, Flood, Fast Splittable Pseudorandom Number Generators (2014), SplitMix64.
"""

import numpy as np

from trolley.jit import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_LANE = np.uint64(0xFFFF)
_SHIFT_16 = np.uint64(16)
_SHIFT_27 = np.uint64(27)
_SHIFT_30 = np.uint64(30)
_SHIFT_31 = np.uint64(31)
_SHIFT_32 = np.uint64(32)
_SHIFT_48 = np.uint64(48)

# Four 16-bit lanes are uniform on 0 ... 65535: mean of their sum, and 1 / its deviation.
_SUM_MEAN = 131070.0
_SUM_SCALE = 1.0 / 37837.2272


@kernel
def random_bits(counter: np.uint64) -> np.uint64:
    """Return 64 random bits that belong to a counter."""
    z = counter * _GOLDEN
    z = (z ^ (z >> _SHIFT_30)) * _MIX_1
    z = (z ^ (z >> _SHIFT_27)) * _MIX_2
    return z ^ (z >> _SHIFT_31)


@kernel
def normal(counter: np.uint64) -> float:
    """Return a number of mean 0 and deviation 1 that belongs to a counter.

    It is the sum of four uniform numbers, so never beyond 3.47; the caller adds wider tails.
    """
    bits = random_bits(counter)
    total = (
        (bits & _LANE)
        + ((bits >> _SHIFT_16) & _LANE)
        + ((bits >> _SHIFT_32) & _LANE)
        + (bits >> _SHIFT_48)
    )
    return (np.int32(total) - _SUM_MEAN) * _SUM_SCALE
