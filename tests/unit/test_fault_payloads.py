"""What the table of faults sends: something valid and something broken for every row there is."""

import pytest
from bench.faults.payloads import Target, broken, targets, valid

from trolley import requests, topics
from trolley.topics import Kind

TARGETS = targets("robot")


def test_no_row_of_the_tables_is_left_out() -> None:
    rows = [topic for topic in topics.TOPICS if topic.kind is not Kind.TOKEN]
    assert len(TARGETS) == len(rows) + len(requests.REQUESTS)
    for topic in rows:
        assert any(topic.match(target.key) for target in TARGETS), topic.name


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.key)
def test_each_row_has_a_valid_message_and_broken_ones(target: Target) -> None:
    assert target.accepts(valid(target.kind))
    payloads = dict(broken(target))
    assert len(payloads) >= 8
    assert not any(target.accepts(payload) for payload in payloads.values())
