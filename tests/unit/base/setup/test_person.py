"""What counts as an answer, and what is refused with the reason."""

import pytest

from trolley.messages import SetupChoice, SetupQuestion
from trolley_base.setup.person import YES_OR_NO, checked

TICKS = SetupQuestion(text="Ticks", kind="whole", least=0.0, greatest=100_000.0, is_above=True)
LENGTH = SetupQuestion(text="Length", kind="number", least=0.05, greatest=3.0)
NAME = SetupQuestion(text="Name", kind="name", default="trolley")


@pytest.mark.parametrize(
    ("question", "answer", "taken"),
    [
        (NAME, "", "trolley"),
        (NAME, " karl ", "karl"),
        (LENGTH, "0.05", "0.05"),
        (LENGTH, "3", "3"),
        (TICKS, "1550", "1550"),
        (SetupQuestion(text="Go?", kind="choice", choices=YES_OR_NO), "no", "no"),
    ],
)
def test_a_good_answer_is_taken(question: SetupQuestion, answer: str, taken: str) -> None:
    assert checked(question, answer) == taken


@pytest.mark.parametrize(
    ("question", "answer", "why"),
    [
        (NAME, "Karl", "A robot's name"),
        (NAME, "a/b", "A robot's name"),
        (NAME, "k" * 33, "A robot's name"),
        (LENGTH, "", "a number"),
        (LENGTH, "wide", "a number"),
        (LENGTH, "nan", "a number"),
        (LENGTH, "1e999", "a number"),
        (LENGTH, "0.04", "at least 0.05"),
        (LENGTH, "3.01", "at most 3"),
        (TICKS, "0", "above 0"),
        (TICKS, "12.5", "a whole number"),
        (TICKS, "9" * 5000, "a whole number"),
        (TICKS, "9" * 400, "a whole number"),
        (SetupQuestion(text="Go?", kind="choice", choices=YES_OR_NO), "maybe", "yes, no"),
        (
            SetupQuestion(text="?", kind="choice", choices=[SetupChoice(answer="a", label="b")]),
            "b",
            "one of a",
        ),
        (SetupQuestion(text="?", kind="text"), "  ", "answer something"),
        (SetupQuestion(text="?", kind="hold"), "hold", "no question"),
    ],
)
def test_rubbish_is_refused_with_the_reason(question: SetupQuestion, answer: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        checked(question, answer)
