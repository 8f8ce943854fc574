"""`pose/capture`, and `tour/offer`."""

import math
from typing import TYPE_CHECKING

import pytest

from trolley import codes, requests
from trolley.codes import Refused
from trolley.geometry import Pose2D, Twist2D
from trolley.messages.request_params import AskOffer, Capture

from .conftest import replace

if TYPE_CHECKING:
    from .conftest import Home, Plan


def capture(home: "Home", **params):
    return home.lockstep.ask(requests.POSE_CAPTURE, Capture(**params))


def code_of(home: "Home", **params) -> str:
    with pytest.raises(Refused) as caught:
        capture(home, **params)
    return caught.value.code


def test_without_a_name_the_newest_estimate_is_told_and_nothing_saved(home: "Home"):
    told = capture(home)
    assert (told.name, told.map, told.pose) == ("", "apartment", Pose2D(1.0, 2.0, 0.5))
    assert (told.state, told.match) == ("localized", 0.9)
    assert 0.0 <= told.age < 0.2
    assert "" not in home.tour.places.items


def test_with_a_name_the_mean_of_five_is_saved(home: "Home"):
    offsets = [-0.02, -0.01, 0.0, 0.01, 0.02]
    home.localizer.jitter = [
        Pose2D(1.0 + off, 2.0 - off, math.pi + off if off < 0.005 else -math.pi + off)
        for off in offsets
    ]
    saved = capture(home, name="sofa", icon="home")
    assert saved.pose.x == pytest.approx(1.0)
    assert saved.pose.y == pytest.approx(2.0)
    assert abs(saved.pose.yaw) == pytest.approx(math.pi)
    assert saved.covariance is not None
    assert saved.covariance[0] == pytest.approx(1e-4 + 2e-4)
    kept = home.tour.places.items["sofa"]
    assert (kept.pose, kept.icon, kept.map) == (saved.pose, "home", "apartment")


def test_name_that_is_taken_needs_replace(home: "Home"):
    assert code_of(home, name="kitchen") == codes.EXISTS
    assert capture(home, name="kitchen", replace=True).name == "kitchen"
    assert home.tour.places.items["kitchen"].pose == Pose2D(1.0, 2.0, 0.5)


def test_bad_name_is_refused(home: "Home"):
    assert code_of(home, name="../kitchen") == codes.BAD_REQUEST


@pytest.mark.parametrize("twist", [Twist2D(0.03, 0.0, 0.0), Twist2D(0.0, 0.0, -0.06)])
def test_moving_robot_is_refused_only_with_a_name(home: "Home", twist: Twist2D):
    home.base.twist = twist
    assert code_of(home, name="sofa") == codes.MOVING
    assert capture(home).pose == Pose2D(1.0, 2.0, 0.5)
    assert "sofa" not in home.tour.places.items


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"state": "lost"}, codes.LOST),
        ({"state": "searching"}, codes.LOST),
        ({"pose": None, "covariance": None}, codes.LOST),
        ({"covariance": [0.03, 0, 0, 0, 0, 0, 0, 0, 0]}, codes.NOT_CONVERGED),
        ({"covariance": [0.012, 0.012, 0, 0.012, 0.012, 0, 0, 0, 0]}, codes.NOT_CONVERGED),
        ({"covariance": [0, 0, 0, 0, 0, 0, 0, 0, 0.01]}, codes.NOT_CONVERGED),
        ({"covariance": None}, codes.NOT_CONVERGED),
    ],
)
def test_doubtful_estimate_is_refused(home: "Home", changes, code):
    home.localizer.estimate = replace(home.localizer.estimate, **changes)
    home.lockstep.run(0.3)
    assert code_of(home) == code
    assert code_of(home, name="sofa") == code


def test_unsure_robot_tells_where_it_is_but_saves_nothing(home: "Home"):
    home.localizer.estimate = replace(home.localizer.estimate, state="unsure")
    home.lockstep.run(0.3)
    assert capture(home).state == "unsure"
    # Of the scan it says nothing: it may fit well, and the place still have to be proven.
    with pytest.raises(codes.Refused, match=codes.SENTENCES[codes.NOT_CONVERGED]):
        capture(home, name="sofa")


def test_estimates_that_jump_are_refused(home: "Home"):
    home.localizer.jitter = [Pose2D(float(step % 2), 2.0, 0.5) for step in range(20)]
    assert code_of(home, name="sofa") == codes.NOT_CONVERGED


def test_old_estimate_is_refused(home: "Home"):
    home.localizer.silent = True
    home.lockstep.run(1.5)
    assert code_of(home) == codes.STALE
    assert code_of(home, name="sofa") == codes.STALE


def test_too_few_estimates_are_refused_in_time(home: "Home"):
    home.lockstep.run(0.05)
    home.localizer.silent = True
    before_ns = home.lockstep.now_ns
    assert code_of(home, name="sofa") == codes.STALE
    assert home.lockstep.now_ns - before_ns < 1.9e9


def test_two_estimates_are_enough(home: "Home"):
    home.localizer.silent = True
    home.lockstep.run(0.2)
    home.localizer.silent = False
    before_ns = home.lockstep.now_ns
    replies = []
    key = requests.POSE_CAPTURE.key("trolley") + "?name=sofa"
    home.lockstep.bus.get(key, b"", "", 2.0, replies.append, lambda: None)
    home.lockstep.run(0.25)
    home.localizer.silent = True
    home.lockstep.run(1.5)
    assert len(replies) == 1
    assert not replies[0].is_error
    assert home.lockstep.now_ns - before_ns < 1.9e9
    assert "sofa" in home.tour.places.items


def test_without_a_base_nothing_is_told(home: "Home"):
    home.lockstep.kill("base")
    home.lockstep.run(2.0)
    assert code_of(home) == codes.STALE


def test_offer_of_a_free_robot_is_its_time_of_arrival(home: "Home"):
    offer = home.lockstep.ask(requests.TOUR_OFFER, AskOffer(name="kitchen"))
    assert (offer.free, offer.seconds, offer.reason) == (True, 10.0, "")


def test_offer_of_a_busy_robot_is_not_free(home: "Home"):
    home.start("kitchen")
    offer = home.lockstep.ask(requests.TOUR_OFFER, AskOffer(pose=Pose2D(0, 0, 0)))
    assert (offer.free, offer.seconds) == (False, 10.0)


def test_offer_says_why_there_is_none(home: "Home", plan: "type[Plan]"):
    def reason(**place) -> str:
        offer = home.lockstep.ask(requests.TOUR_OFFER, AskOffer(**place))
        assert offer.seconds is None
        return offer.reason

    assert reason(name="cellar") == codes.UNKNOWN_NAME
    home.planner.script = [plan(refuse=Refused(codes.NO_PATH))]
    assert reason(name="kitchen") == codes.NO_PATH
    home.lockstep.kill("planner")
    assert reason(name="kitchen") == codes.NOT_READY
