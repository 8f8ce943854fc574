"""A hand that drives: what it sends while it holds, and after."""

from trolley.geometry import Twist2D
from trolley.teleop import ZERO_NS, Hand, twist_words

FORWARD = Twist2D(0.2, 0.0, 0.0)


def test_a_hand_sends_zero_for_a_moment_and_then_nothing() -> None:
    hand = Hand()
    assert hand.step(None, 0) is None
    assert hand.step(FORWARD, 1_000) == FORWARD
    assert hand.step(None, 2_000) == Twist2D.zero()
    assert hand.step(None, 1_000 + ZERO_NS) == Twist2D.zero()
    assert hand.step(None, 1_001 + ZERO_NS) is None
    assert hand.step(None, 1_002 + ZERO_NS) is None
    assert hand.step(FORWARD, 2 * ZERO_NS) == FORWARD


def test_a_velocity_in_words() -> None:
    assert twist_words(Twist2D.zero()) == "standing"
    assert twist_words(Twist2D(0.25, 0.0, 0.8)) == "forward 0.25 m/s, turning left 0.80 rad/s"
    assert twist_words(Twist2D(-0.1, -0.2, -1e-4)) == "back 0.10 m/s, sideways right 0.20 m/s"
