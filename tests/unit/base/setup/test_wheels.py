"""What a person sees of wheels in the air tells how they are wired."""

import itertools

import pytest

from trolley_base.setup.record import SetupRefused
from trolley_base.setup.wheels import (
    DIRECTIONS,
    Counted,
    Seen,
    Wiring,
    judge_counts,
    judge_wiring,
)


def seen(wiring: Wiring, left: int, right: int) -> Seen:
    """How wheels turn when the board drives its left and its right motor so."""
    if wiring.is_swapped:
        left, right = right, left
    turned = (
        -left if wiring.left_is_reversed else left,
        -right if wiring.right_is_reversed else right,
    )
    return next(name for name, one in DIRECTIONS.items() if one == turned)


@pytest.mark.parametrize("flags", list(itertools.product((False, True), repeat=3)))
def test_every_wiring_is_told_from_two_answers(flags: tuple[bool, bool, bool]) -> None:
    wiring = Wiring(*flags)
    assert judge_wiring(seen(wiring, 1, 1), seen(wiring, -1, 1)) == wiring
    assert wiring.is_right is not any(flags)


def test_answers_that_cannot_be_are_refused() -> None:
    with pytest.raises(SetupRefused, match="Look again"):
        judge_wiring("both forward", "both forward")
    with pytest.raises(SetupRefused, match="does not turn"):
        judge_wiring("not both", "right forward")


@pytest.mark.parametrize(
    ("counted", "words"),
    [
        (Counted(0.0, 1.0), "board's left wheel counts nothing"),
        (Counted(1.0, 0.02), "board's right wheel counts nothing"),
        (Counted(0.0, 0.0), "Both encoders count nothing"),
        (Counted(1.0, -1.0), "board's right wheel counts against"),
        (Counted(-1.0, -0.9), "left and right wheel counts against"),
    ],
)
def test_an_encoder_that_does_not_count_up_is_named(counted: Counted, words: str) -> None:
    with pytest.raises(SetupRefused, match=words):
        judge_counts(counted)


def test_encoders_that_count_up_are_good() -> None:
    judge_counts(Counted(0.8, 1.2))
