"""Wishes on stored keys: put and delete are two bindings of one topic."""

from trolley import topics
from trolley.messages import SavedPose
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, on, on_delete


class Keeper(Service):
    name = "tour"

    def __init__(self) -> None:
        self.heard: list[tuple[str, str]] = []

    @on(topics.SAVED_POSE)
    def put(self, pose: SavedPose, name: str) -> None:
        self.heard.append(("put", name))

    @on_delete(topics.SAVED_POSE)
    def delete(self, name: str) -> None:
        self.heard.append(("delete", name))


def test_each_wish_is_heard_and_a_bad_one_counted_once():
    with Lockstep() as lockstep:
        keeper = lockstep.add(Keeper())
        key = topics.SAVED_POSE.key("trolley", "kitchen")
        lockstep.put(key, b'{"pose": {"x": 1, "y": 2, "yaw": 0}}')
        lockstep.put(key, b"{}")
        lockstep.delete(key)
        assert keeper.heard == [("put", "kitchen"), ("delete", "kitchen")]
        assert lockstep.counters("tour") == {"poses/invalid": 1}
