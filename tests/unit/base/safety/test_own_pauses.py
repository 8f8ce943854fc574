from trolley_base.safety.own_pauses import OwnPauses

MS = 1_000_000


def noted(pauses: OwnPauses, *at_ms: int) -> list[int]:
    return [pauses.note(ms * MS) // MS for ms in at_ms]


def test_a_long_pause_is_remembered_for_a_second() -> None:
    pauses = OwnPauses()
    assert noted(pauses, 5000, 5020, 5160) == [0, 0, 0]
    assert noted(pauses, 5760, 5780) == [600] * 2
    assert noted(pauses, *range(5800, 6761, 20)) == [600] * 49
    assert noted(pauses, 6780) == [0]


def test_one_short_pause_is_chance_and_two_are_not() -> None:
    pauses = OwnPauses()
    assert noted(pauses, 0, 300, *range(320, 5200, 20)) == [0] * 246
    assert noted(pauses, 5500, *range(5520, 5600, 20)) == [0] * 5
    assert noted(pauses, 5800) == [220]


def test_pauses_that_go_on_are_not_forgotten() -> None:
    pauses = OwnPauses()
    assert noted(pauses, 0, 200) == [0, 0]
    assert set(noted(pauses, *range(400, 4000, 200))) == {200}
