"""States that were reached: a hash table with open addresses, and a heap of them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import lean_kernel
from trolley_planner.paths.heap import sift_up
from trolley_planner.paths.hybrid_astar.footprint_spans import HEADINGS, TURN_RAD, FootprintSpans
from trolley_planner.paths.hybrid_astar.motion_primitives import CELL_M, TURNING, Motions
from trolley_planner.paths.hybrid_astar.search_space import SearchSpace, can_turn

STATES = 2**18
"""Number of states that can be remembered, a power of two: 24 MB with the heap."""
USABLE = int(0.75 * STATES)
"""Number of states after which a search ends without an answer."""
GOAL_KEY = 2**62
"""Stands for the goal itself, at the end of a direct drive."""
NONE = -1
NUM_STATES, NUM_QUEUED, SEARCH_NUMBER, CAME_THERE = range(4)
"""Indices of `Memory.counts`."""


class Memory(NamedTuple):
    """The states of one search, and what is left of earlier ones."""

    stamps: NDArray[np.int32]
    """(STATES,) number of the search in which the entry was made."""
    keys: NDArray[np.int64]
    """(STATES,) cell and heading; the first heading where there is room to turn."""
    headings: NDArray[np.int8]
    """(STATES,) index of the heading with which it was reached."""
    places: NDArray[np.float32]
    """(STATES, 2) exact place."""
    costs: NDArray[np.float32]
    """(STATES,) cost from the start."""
    previous: NDArray[np.int32]
    """(STATES,) state from which it was reached."""
    motions: NDArray[np.int8]
    """(STATES,) motion with which it was reached."""
    closed: NDArray[np.uint8]
    """(STATES,) whether the cheapest path to it is known."""
    heap: NDArray[np.float64]
    """(entries, 2) estimated cost of the whole path, and the state."""
    counts: NDArray[np.int64]
    """(4,) states reached by the search, entries of the heap, number of the search, and whether it
    came to the goal's place, whatever the heading."""


class Reached(NamedTuple):
    """A state, and how it was reached."""

    key: int
    x: float
    y: float
    heading: int
    cost: float
    previous: int
    motion: int


def make_memory() -> Memory:
    """Return one in which no search has left anything."""
    return Memory(
        np.zeros(STATES, dtype=np.int32),
        np.empty(STATES, dtype=np.int64),
        np.empty(STATES, dtype=np.int8),
        np.empty((STATES, 2), dtype=np.float32),
        np.empty(STATES, dtype=np.float32),
        np.empty(STATES, dtype=np.int32),
        np.empty(STATES, dtype=np.int8),
        np.empty(STATES, dtype=np.uint8),
        np.empty((4 * STATES, 2), dtype=np.float64),
        np.zeros(4, dtype=np.int64),
    )


@lean_kernel
def begin_anew(memory: Memory) -> None:
    """Forget the search before."""
    memory.counts[NUM_STATES], memory.counts[NUM_QUEUED], memory.counts[CAME_THERE] = 0, 0, 0
    memory.counts[SEARCH_NUMBER] += 1


@lean_kernel
def key_of(space: SearchSpace, place: tuple[float, float], heading: int) -> int:
    """Return the key of the state at a place."""
    row, col = math.floor(place[1] / CELL_M), math.floor(place[0] / CELL_M)
    cell = (row * space.state_cols + col) * HEADINGS
    return cell if can_turn(space, place, 0.0) else cell + heading


@lean_kernel
def slot_of(memory: Memory, key: int) -> int:
    """Return where a state is, or where it goes if it was not reached."""
    size, number = memory.keys.shape[0], memory.counts[SEARCH_NUMBER]
    slot = ((key * 2654435761) >> 11) & (size - 1)
    while memory.stamps[slot] == number and memory.keys[slot] != key:
        slot = (slot + 1) & (size - 1)
    return slot


@lean_kernel
def is_reached(memory: Memory, slot: int) -> bool:
    """Say whether this search has reached the state of a slot."""
    return memory.stamps[slot] == memory.counts[SEARCH_NUMBER]


@lean_kernel
def remember(memory: Memory, reached: Reached, estimate: float) -> bool:
    """Keep a state, in place of a dearer path to it; False if the memory is full.

    Args:
        memory: changed in place.
        reached: the state.
        estimate: of the cost of the whole path through it.
    """
    slot = slot_of(memory, reached.key)
    if not is_reached(memory, slot):
        if memory.counts[NUM_STATES] >= USABLE:
            return False
        memory.counts[NUM_STATES] += 1
        memory.stamps[slot], memory.keys[slot] = memory.counts[SEARCH_NUMBER], reached.key
    if memory.counts[NUM_QUEUED] >= memory.heap.shape[0]:
        return False
    memory.closed[slot] = 0
    memory.places[slot, 0], memory.places[slot, 1] = reached.x, reached.y
    memory.headings[slot], memory.motions[slot] = reached.heading, reached.motion
    memory.costs[slot], memory.previous[slot] = reached.cost, reached.previous
    sift_up(memory.heap, memory.counts[NUM_QUEUED], estimate, slot)
    memory.counts[NUM_QUEUED] += 1
    return True


def traced(memory: Memory, last: int, footprint: FootprintSpans) -> Motions:
    """Return the poses (n, 3) of the states that led to the last, and how each was reached."""
    states: list[int] = []
    state = last if int(memory.keys[last]) != GOAL_KEY else int(memory.previous[last])
    while state != NONE:
        states.append(state)
        state = int(memory.previous[state])
    chosen = np.array(states[::-1], dtype=np.int64)
    headings = memory.headings[chosen].astype(np.int64)
    yaws = np.unwrap(footprint.first_yaw + headings * TURN_RAD)
    poses = np.empty((len(chosen), 3))
    poses[:, :2], poses[:, 2] = memory.places[chosen], yaws
    motions = memory.motions[chosen]
    # Where there is room, a state is reached by a turn of any size and a line.
    parts, kinds = [poses[:1]], [motions[:1]]
    for index in range(1, len(poses)):
        turn = float(poses[index, 2] - poses[index - 1, 2])
        count = round(abs(turn) / TURN_RAD)
        if count > 1:
            turned = np.repeat(poses[index - 1 : index], count, axis=0)
            turned[:, 2] += turn * np.arange(1, count + 1) / count
            parts.append(turned)
            kinds.append(np.full(count, TURNING, dtype=np.int8))
        parts.append(poses[index : index + 1])
        kinds.append(motions[index : index + 1])
    return np.concatenate(parts), np.concatenate(kinds)
