"""How old what arrives may be."""

from trolley_mqtt.freshness import MAX_UNANSWERED, Freshness


def test_freshness_is_the_age_of_the_newest_mark_that_came_back() -> None:
    freshness = Freshness()
    assert not freshness.is_fresh(0)
    first = freshness.mark(1_000_000_000)
    assert not freshness.is_fresh(1_000_000_000)
    assert freshness.update(first)
    assert not freshness.update(first)
    assert freshness.is_fresh(4_000_000_000)
    assert not freshness.is_fresh(4_100_000_000)
    freshness.renew()
    assert freshness.age_s(4_100_000_000) is None


def test_marks_without_an_answer_are_bounded() -> None:
    freshness = Freshness()
    marks = [freshness.mark(index) for index in range(1000)]
    assert not freshness.update(marks[0])
    assert freshness.update(marks[-1])


def test_a_broker_from_which_no_mark_comes_back_passes_nothing_on() -> None:
    freshness = Freshness()
    marks = [freshness.mark(second) for second in range(MAX_UNANSWERED)]
    assert not freshness.is_cut_off()
    marks.append(freshness.mark(MAX_UNANSWERED))
    assert freshness.is_cut_off()
    freshness.update(marks[-1])  # those before it were lost
    for second in range(10, 10 + MAX_UNANSWERED):
        freshness.mark(second)
    assert not freshness.is_cut_off()


def test_a_bridge_that_stood_still_is_not_cut_off() -> None:
    """It took its own pause of some seconds for an account without rights."""
    freshness = Freshness()
    freshness.update(freshness.mark(1_000_000_000))
    freshness.mark(9_000_000_000)
    assert not freshness.is_cut_off()
