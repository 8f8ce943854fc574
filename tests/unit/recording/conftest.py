"""Small recordings, written as `trolley record` writes them."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs
from support.samples import make_clock, make_estimate, make_robot

from trolley import topics
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.topics import Topic

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS

ROBOT = structs.replace(make_robot(), title="The first")


def sample_of(
    topic: Topic[Any], message: Any, *parts: str, fmt: codec.Format = "msgpack"
) -> Sample:
    """A message as it comes from the wire of robot `one`."""
    return Sample(topic.key("one", *parts), codec.encode(message, fmt), codec.MIME[fmt])


Timed = tuple[float, Sample]
WriteRecording = Callable[..., Path]


@pytest.fixture
def write_recording(tmp_path: Path) -> WriteRecording:
    """Write samples with their seconds of arrival; a chunk ends with each second."""

    def write(samples: Iterable[Timed], name: str = "one.mcap", *, finish: bool = True) -> Path:
        path = tmp_path / name
        with RecordingWriter(path, "one", {}) as writer:
            recorder = Recorder(writer, "one")
            last_s = 0.0
            for at_s, sample in samples:
                if int(at_s) > int(last_s):
                    writer.flush()
                last_s = at_s
                recorder.take(sample, round(at_s * SECOND_NS), START_NS)
            writer.flush()
            if finish:
                writer.finish()
        return path

    return write


def drive(seconds: float) -> list[Timed]:
    """Clock and robot, and ten poses a second, of robot `one`."""
    timed: list[Timed] = [(0.0, sample_of(topics.ROBOT, ROBOT))]
    for step in range(int(seconds * 10)):
        stamp_ns = START_NS + step * SECOND_NS // 10
        timed.append((0.1 * step, sample_of(topics.CLOCK, make_clock(stamp_ns, epoch=START_NS))))
        timed.append((0.1 * step, sample_of(topics.POSE, make_estimate(stamp_ns))))
    return timed
