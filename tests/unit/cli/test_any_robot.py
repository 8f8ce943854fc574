"""Whichever robot is free and there first."""

import pytest

from trolley import codes
from trolley.cli.any_robot import in_order
from trolley.codes import Refused
from trolley.messages import Offer


def test_the_free_robot_that_is_there_first_goes() -> None:
    offers = {
        "a": Offer(free=True, seconds=20.0),
        "b": Offer(free=False, seconds=3.0, reason=codes.BUSY),
        "c": Offer(free=True, seconds=12.5),
        "d": Offer(free=True, reason=codes.NO_PATH),
    }
    assert in_order(offers) == ["c", "a"]


def test_of_two_as_near_the_first_name_goes() -> None:
    offers = {name: Offer(free=True, seconds=5.0) for name in ("b", "a")}
    assert in_order(offers) == ["a", "b"]


def test_it_is_said_of_each_why_none_goes() -> None:
    offers = {
        "a": Offer(free=False, seconds=3.0, reason=codes.CHARGING),
        "b": Offer(free=True, reason=codes.NOT_LOCALIZED),
    }
    with pytest.raises(Refused) as caught:
        in_order(offers)
    assert caught.value.code == codes.BUSY
    assert caught.value.details["robots"] == {"a": codes.CHARGING, "b": codes.NOT_LOCALIZED}
    assert "a: The robot is charging." in caught.value.message
