"""Waveshare's lines: however they are cut and whatever else arrives, what a slow reader reads."""

import json
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from support.emulated_boards import dialogue_of

from trolley.geometry import Twist2D

MS = 1_000_000
NUMBER = st.floats(-2.9, 2.9).map(lambda value: round(value, 3))
REPORTS = st.builds(
    lambda left, right, v: json.dumps({"T": 1001, "L": left, "R": right, "v": v}).encode(),
    NUMBER,
    NUMBER,
    st.floats(0.0, 13.0),
)
OTHERS = st.sampled_from(
    [
        b'{"T":136,"cmd":400}',
        b'{"T":900,"main":2,"module":0}',
        b'{"T":1001}',
        b"[1]",
        b"null",
        b'{"T":1001,"L":200,"R":0}',
        b"UGV started.",
        b'{"T":{"T":1001},"L":0.1,"R":0.1}',
        b"\xff\xfe{",
        b"",
    ]
)
STREAM = st.lists(REPORTS | OTHERS | st.binary(max_size=30), max_size=20)


def slow_reports(stream: bytes) -> int:
    """How many lines are reports, by Python's own parser, line by line."""
    number = 0
    for line in stream.split(b"\n")[:-1]:
        try:
            message: Any = json.loads(line.strip())
        except ValueError:
            continue
        if isinstance(message, dict) and message.get("T") == 1001:
            sides: list[Any] = [message.get("L"), message.get("R")]
            number += all(type(side) in (int, float) and math.isfinite(side) for side in sides)
    return number


@settings(deadline=None)
@given(lines=STREAM, cuts=st.lists(st.integers(0, 400), max_size=6), wait_ms=st.integers(0, 300))
def test_reports_are_those_of_a_slow_reader(
    lines: list[bytes], cuts: list[int], wait_ms: int
) -> None:
    stream = b"".join(line + b"\r\n" for line in lines)
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.outgoing(0)
    now_ns, at, motions, told = 0, 0, 0, set[bytes]()
    for end in sorted({*(min(cut, len(stream)) for cut in cuts), len(stream)}):
        now_ns += wait_ms * MS
        dialogue.receive(stream[at:end], now_ns)
        at = end
        dialogue.drive(Twist2D(0.3, 0.0, 0.0))
        out = dialogue.outgoing(now_ns)
        assert out == b"" or out.endswith(b"\n")
        drives = {line for line in out.split(b"\n") if line.startswith(b'{"T":1,')}
        assert drives <= {b'{"T":1,"L":0.0,"R":0.0}'} or dialogue.status(now_ns).state == "up"
        told |= drives
        motions += len(dialogue.take(now_ns).motions)
    known = slow_reports(stream) > 0 or any(line in stream for line in (b'"cmd":400',))
    assert known or not told
    assert motions <= max(0, slow_reports(stream) - 1)


@settings(deadline=None)
@given(st.lists(REPORTS, min_size=2, max_size=20), st.integers(1, 50))
def test_every_report_after_the_first_is_a_motion(reports: list[bytes], chunk: int) -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.outgoing(0)
    dialogue.receive(b'{"T":136,"cmd":400}\n{"T":900,"main":2,"module":0}\n', 1)
    motions = 0
    for number, report in enumerate(reports):
        line = report + b"\r\n"
        for at in range(0, len(line), chunk):
            dialogue.receive(line[at : at + chunk], (number + 1) * 45 * MS)
        motions += len(dialogue.take(0).motions)
    assert motions == len(reports) - 1
