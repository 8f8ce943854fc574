from trolley_planner.driving.progress_monitor import Patience


def test_who_comes_where_a_thing_was_waited_for_is_waited_for_as_long_as_anybody() -> None:
    patience = Patience()
    assert patience.lasts(12.0, 15.0, waits=True)
    patience.begin_with_somebody()
    assert patience.lasts(9.0, 10.0, waits=True)
    patience.begin_with_somebody()
    assert not patience.lasts(2.0, 10.0, waits=True)
