"""A stream that nobody hears is made once it is asked for."""

from trolley import topics
from trolley.messages import BeamClasses
from trolley.runtime import codec
from trolley.runtime.lockstep import Lockstep, MemoryBus
from trolley.runtime.service import Service


class DeafBus(MemoryBus):
    """A bus on which nobody listens."""

    def is_heard(self, key: str, encoding: str) -> bool:
        del key, encoding
        return False


class Maker(Service):
    name = "localizer"

    def __init__(self) -> None:
        self.made = 0

    def make(self) -> BeamClasses:
        self.made += 1
        return BeamClasses(stamp_ns=self.made, classes=memoryview(b""))


def test_what_nobody_hears_is_made_for_who_asks_and_only_once():
    with Lockstep() as lockstep:
        lockstep.bus = DeafBus()
        maker = lockstep.add(Maker())
        for _ in range(3):
            maker.publish_if_heard(topics.BEAMS, maker.make)
        assert maker.made == 0
        key = topics.BEAMS.key("trolley")
        for _ in range(2):
            (reply,) = lockstep.get(f"{key}?format=msgpack")
            assert codec.decode(BeamClasses, reply.payload, reply.encoding).stamp_ns == 1


def test_what_is_heard_is_published_as_it_is_made():
    with Lockstep() as lockstep:
        maker = lockstep.add(Maker())
        heard = lockstep.record(topics.BEAMS)
        maker.publish_if_heard(topics.BEAMS, maker.make)
        maker.publish_if_heard(topics.BEAMS, maker.make)
        assert [one.stamp_ns for one in heard] == [1, 2]
