"""Rules over distance and bearing: the first that matches gives an overlay its text and colour."""

from collections.abc import Sequence

from trolley.geometry.pose import TWO_PI
from trolley.messages import OverlayRule

ROUNDING = 1e-9
MAX_RULES = 100
"""Further rules of an overlay are ignored."""


def first_match(
    rules: Sequence[OverlayRule], distance: float | None, bearing: float | None
) -> OverlayRule | None:
    """The first rule whose bounds hold distance [m] and bearing [rad]; None if none does.

    A missing bound is open. What is not known lies within no bounds.
    """
    return next((rule for rule in rules[:MAX_RULES] if matches(rule, distance, bearing)), None)


def matches(rule: OverlayRule, distance: float | None, bearing: float | None) -> bool:
    """Whether distance [m] and bearing [rad] lie within the bounds of a rule, ends included."""
    return _lies_between(distance, rule.distance_min, rule.distance_max) and _points_between(
        bearing, rule.bearing_min, rule.bearing_max
    )


def _lies_between(value: float | None, low: float | None, high: float | None) -> bool:
    if low is None and high is None:
        return True
    if value is None:
        return False
    return (low is None or value >= low) and (high is None or value <= high)


def _points_between(angle: float | None, low: float | None, high: float | None) -> bool:
    """As above, counter-clockwise from `low` to `high`; low > high: over pi, behind the back."""
    if low is None or high is None or angle is None:
        return _lies_between(angle, low, high)
    if high - low >= TWO_PI:
        return True
    width, turned = _turn(high - low), _turn(angle - low)
    return turned <= width + ROUNDING


def _turn(angle: float) -> float:
    """A turn counter-clockwise, 0 to under 2 pi; what misses a full one by rounding is none."""
    turn = angle % TWO_PI
    return turn if turn < TWO_PI - ROUNDING else 0.0
