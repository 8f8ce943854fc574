"""Who stays of two processes of one service."""

import itertools

from trolley.runtime.clash import Run, host_name


def test_the_older_one_is_the_smaller():
    runs = [
        Run(started_ms=1, host="b", pid=9),
        Run(started_ms=2, host="a", pid=1),
        Run(started_ms=2, host="a", pid=2),
        Run(started_ms=2, host="b", pid=1),
    ]
    assert all(min(order) == runs[0] for order in itertools.permutations(runs))
    assert sorted([runs[3], runs[1], runs[0], runs[2]]) == runs


def test_a_run_is_read_as_it_is_written():
    for run in (Run.here(), Run(started_ms=1_790_000_000_000, host="my-pi.lan-2", pid=42)):
        assert Run.parse(str(run)) == run
    assert "/" not in host_name()


def test_what_is_no_run_is_nothing():
    for text in ("", "host", "host-1", "host-a-1", "-1-2", "host-1-" + "9" * 5000):
        assert Run.parse(text) is None
