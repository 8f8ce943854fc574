"""Whether what was seen at different times agrees on the finished map; where not, it may be wrong.

Each scan is compared with those that were taken near it, but a good way before or after. The graph
cannot tell: its edges hold what was believed, and where a loop was missed none contradicts.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.slices import Slices
from trolley_mapper.slam.agreement import count_explained
from trolley_mapper.slam.keyframe_store import KeyframeStore


@dataclass(frozen=True, slots=True)
class MapCheckParams:
    """What is compared, and what speaks against a map. Found with bench/mapper/."""

    around_m: float = 4.0
    """Distance within which scans are compared [m]."""
    apart_m: float = 10.0
    """Distance driven between them at least: those in between were matched with each other [m]."""
    most: int = 8
    """Number of scans that one is compared with at most."""
    reach_m: float = 9.0
    """Distance within which surfaces are compared [m]."""
    near_m: float = 0.15
    """Distance from a surface within which a point lies on it [m]."""
    min_known: int = 60
    """Number of points in what the others know below which a comparison says nothing."""
    min_scans: int = 3
    """Number of scans in a row that must speak against the map together: one may be of a person."""
    over_m: float = 2.0
    """Distance driven over which they must [m]."""
    within_m: float = 8.0
    """Distance driven beyond which scans are no row [m]."""
    wrong_share: float = 0.6
    """Share of the points known to the others on their surfaces below which the map is doubted."""
    place_m: float = 5.0
    """Distance within which what is doubted is one place [m]."""
    per_slice: int = 16
    """Number of scans compared in one slice."""


PARAMS = MapCheckParams()


@dataclass(frozen=True, slots=True)
class Comparison:
    """What other times make of a scan.

    Attributes:
        place: (2,) where it was taken, x, y [m] in `map`.
        way_m: distance driven until then [m].
        known: number of its points in what they know.
        explained: number of these that lie on surfaces that they saw.
    """

    place: NDArray[np.float64]
    way_m: float
    known: int
    explained: int


def contradictions(store: KeyframeStore) -> Slices[list[tuple[float, float]]]:
    """Return the places x, y [m] in `map` where scans contradict each other, the worst first.

    Where a stretch was laid over another that looks the same, nothing contradicts.
    """
    compared = yield from compare_passes(store)
    return doubtful_places(compared)


def compare_passes(store: KeyframeStore) -> Slices[list[Comparison]]:
    """Compare each scan of the map with those taken nearby at other times."""
    places = store.poses[:, :2]
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    is_scan = ~store.loose & np.array(
        [not (one.is_blind or one.is_prior) for one in store.keyframes], bool
    )
    compared: list[Comparison] = []
    for row in np.flatnonzero(is_scan).tolist():
        is_near = np.hypot(*(places - places[row]).T) < PARAMS.around_m
        is_other = is_near & is_scan & (np.abs(way_m - way_m[row]) > PARAMS.apart_m)
        others = [store.keyframes[k].number for k in np.flatnonzero(is_other).tolist()]
        if not others:
            continue
        number = store.keyframes[row].number
        by = store.choose_near(others, store.poses[row], PARAMS.most)
        known, explained = count_explained(
            store, [number], by, number, PARAMS.near_m, PARAMS.reach_m
        )
        if known >= PARAMS.min_known:
            compared.append(Comparison(places[row], float(way_m[row]), known, explained))
        if len(compared) % PARAMS.per_slice == 0:
            yield
    return compared


def explained_shares(compared: list[Comparison]) -> list[tuple[float, NDArray[np.float64]]]:
    """Return of each row of scans the share that the others explain, and the place (2,)."""
    shares: list[tuple[float, NDArray[np.float64]]] = []
    last = 0
    for first, one in enumerate(compared):
        last = max(last, first + PARAMS.min_scans - 1)
        while last < len(compared) and compared[last].way_m - one.way_m < PARAMS.over_m:
            last += 1
        if last >= len(compared):
            break
        if compared[last].way_m - one.way_m <= PARAMS.within_m:
            scans = compared[first : last + 1]
            share = sum(scan.explained for scan in scans) / sum(scan.known for scan in scans)
            shares.append((share, scans[len(scans) // 2].place))
    return shares


def doubtful_places(compared: list[Comparison]) -> list[tuple[float, float]]:
    """Return where a map is doubted, x, y [m], the worst first."""
    doubted = [one for one in explained_shares(compared) if one[0] < PARAMS.wrong_share]
    places: list[NDArray[np.float64]] = []
    for _, place in sorted(doubted, key=lambda one: one[0]):
        if all(np.hypot(*(place - other)) >= PARAMS.place_m for other in places):
            places.append(place)
    return [(float(x), float(y)) for x, y in places]
