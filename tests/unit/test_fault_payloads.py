"""What the table of faults sends: something valid and something broken for every row there is."""

import pytest
from bench.faults.payloads import Target, broken, targets, valid
from bench.faults.robot import SERVICES

from trolley import requests, topics
from trolley.topics import Kind

TARGETS = targets("robot")


def test_no_row_of_the_tables_that_a_running_robot_answers_is_left_out() -> None:
    rows = [topic for topic in topics.TOPICS if topic.kind is not Kind.TOKEN]
    asked = {target.key for target in TARGETS if target.is_request}
    assert asked == {one.key("robot") for one in requests.REQUESTS if one.owner in SERVICES}
    assert len(TARGETS) == len(rows) + len(asked)
    for topic in rows:
        assert any(topic.match(target.key) for target in TARGETS), topic.name


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.key)
def test_each_row_has_a_valid_message_and_broken_ones(target: Target) -> None:
    assert target.accepts(valid(target.kind))
    payloads = dict(broken(target))
    assert len(payloads) >= 8
    assert not any(target.accepts(payload) for payload in payloads.values())
