"""A binary heap of keys and states, for searches that take the least key next."""

import numpy as np
from numpy.typing import NDArray

from trolley.jit import lean_kernel


@lean_kernel
def sift_up(heap: NDArray[np.float64], at: int, key: float, state: int) -> None:
    """Put a state into a binary heap (n, 2) of keys and states, from its end `at` on."""
    while at > 0 and heap[(at - 1) >> 1, 0] > key:
        above = (at - 1) >> 1
        heap[at, 0], heap[at, 1] = heap[above, 0], heap[above, 1]
        at = above
    heap[at, 0], heap[at, 1] = key, state


@lean_kernel
def take_first(heap: NDArray[np.float64], size: int) -> int:
    """Take the state with the least key out of a heap of `size`; return it."""
    first = int(heap[0, 1])
    key, moved = heap[size - 1, 0], heap[size - 1, 1]
    at, last = 0, size - 1
    while 2 * at + 1 < last:
        below = 2 * at + 1
        if below + 1 < last and heap[below + 1, 0] < heap[below, 0]:
            below += 1
        if heap[below, 0] >= key:
            break
        heap[at, 0], heap[at, 1] = heap[below, 0], heap[below, 1]
        at = below
    heap[at, 0], heap[at, 1] = key, moved
    return first
