from trolley_base.safety.own_pauses import OwnPauses

MS = 1_000_000


def test_a_pause_is_remembered_for_a_second() -> None:
    pauses = OwnPauses()
    assert [pauses.note(ms * MS) for ms in (5000, 5020, 5160)] == [0, 0, 0]
    assert [pauses.note(ms * MS) for ms in (5460, 5480)] == [300 * MS] * 2
    assert [pauses.note(ms * MS) for ms in range(5500, 6461, 20)] == [300 * MS] * 49
    assert pauses.note(6480 * MS) == 0


def test_pauses_that_go_on_are_not_forgotten() -> None:
    pauses = OwnPauses()
    assert pauses.note(0) == 0
    assert {pauses.note(ms * MS) for ms in range(200, 4000, 200)} == {200 * MS}
