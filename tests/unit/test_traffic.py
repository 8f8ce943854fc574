"""How often topics come, and how often they should."""

import pytest

from trolley import topics
from trolley.messages import Clock
from trolley.runtime.bus import Sample
from trolley.topics import Topic
from trolley.traffic import LARGEST_KEPT, MOST_KEYS, Expected, Flow, Traffic, expected, flows


def sample(key: str, size: int = 10) -> Sample:
    return Sample(key, b"x" * size, "application/msgpack")


def test_every_rate_of_the_table_is_understood() -> None:
    found = {topic.name: expected(topic) for topic in topics.TOPICS}
    assert found["scan"] == Expected(5.0, 50.0)
    assert found["clock"] == Expected(10.0, 10.0)
    assert found["particles"] == Expected(None, 5.0)
    assert found["tf/{child}"] == Expected(None, 20.0)
    assert found["base"] == Expected(1.0, None)
    assert found["pose"].is_each_scan
    assert found["map"] == Expected()


def test_a_rate_in_other_words_is_refused() -> None:
    with pytest.raises(ValueError, match="now and then"):
        expected(Topic("x", Clock, "x", "now and then"))


@pytest.mark.parametrize(
    ("wanted", "text"),
    [
        (Expected(), ""),
        (Expected(10.0, 10.0), "10"),
        (Expected(5.0, 50.0), "5-50"),
        (Expected(None, 2.0), "≤ 2"),
        (Expected(1.0), "≥ 1"),
        (Expected(is_each_scan=True), "each scan"),
    ],
)
def test_rates_in_words(wanted: Expected, text: str) -> None:
    assert str(wanted) == text


def test_what_came_between_two_moments() -> None:
    traffic = Traffic()
    traffic.take(sample("a"))
    before = traffic.so_far()
    for _ in range(4):
        traffic.take(sample("a", 100))
    traffic.take(sample("b"))
    after = traffic.so_far()
    found = flows(before, after, 2.0, after["b"].last_s + 1.0)
    assert (found["a"].hz, found["a"].bytes_per_s) == (2.0, 200.0)
    assert found["b"] == Flow(0.5, 5.0, 1.0)


def test_strangers_cannot_fill_the_memory() -> None:
    traffic = Traffic()
    for i in range(MOST_KEYS + 10):
        traffic.take(sample(f"key{i}"))
    traffic.take(sample("key0", LARGEST_KEPT + 1))
    found = traffic.so_far()
    assert len(found) == MOST_KEYS
    assert (found["key0"].messages, found["key0"].last) == (2, None)
    assert found["key1"].last == (b"x" * 10, "application/msgpack")
