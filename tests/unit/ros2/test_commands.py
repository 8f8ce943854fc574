from typing import Any

import click
import pytest

from trolley.config import Ros2Config
from trolley_ros2.commands import with_options


def test_what_the_command_line_says_counts_before_the_settings() -> None:
    settings = Ros2Config(domain=3, namespace="/kiwi")
    found = with_options(settings, {"domain": None, "namespace": "/lime", "role": "viewer"})
    assert (found.domain, found.namespace, found.role) == (3, "/lime", "viewer")


def test_the_command_line_gives_no_more_than_the_settings() -> None:
    with pytest.raises(click.UsageError, match="change it there"):
        with_options(Ros2Config(role="viewer"), {"role": "operator"})


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"namespace": "kiwi"}, "'kiwi' is not a namespace"),
        ({"domain": 300}, "--domain"),
        ({"router": "127.0.0.1:7447"}, "is not an endpoint"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], problem: str) -> None:
    with pytest.raises(click.UsageError) as refused:
        with_options(Ros2Config(), options)
    assert problem in refused.value.message
