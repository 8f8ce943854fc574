"""Things that are saved before they count."""

from collections.abc import Callable

import pytest
from msgspec import Struct

from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import SavedPose
from trolley_tour.stored.checks import PosesFile, with_item
from trolley_tour.stored.named_store import NamedStore


class SlowDisk:
    """Saves when it is told to."""

    def __init__(self) -> None:
        self.waiting: list[tuple[list[str], Callable[[str | None], None]]] = []
        self.num_published = 0
        self.answers: list[str] = []
        self.store: NamedStore[SavedPose] = NamedStore(
            "saved place",
            lambda poses: PosesFile(poses=poses),
            self.save,
            self.publish,
        )

    def save(self, content: Struct, then: Callable[[str | None], None]) -> None:
        assert isinstance(content, PosesFile)
        self.waiting.append(([pose.name for pose in content.poses], then))

    def publish(self) -> None:
        self.num_published += 1

    def answer(self, result: SavedPose | Refused) -> None:
        self.answers.append(result.code if isinstance(result, Refused) else result.name)

    def put(self, name: str) -> None:
        pose = SavedPose(name=name, map="a", pose=Pose2D(0.0, 0.0, 0.0))
        self.store.change(lambda items: (with_item(items, pose), pose), self.answer)

    def delete(self, name: str) -> None:
        self.store.delete(name, self.answer)

    def finish(self, problem: str | None = None) -> list[str]:
        names, then = self.waiting.pop(0)
        then(problem)
        return names


@pytest.fixture
def disk() -> SlowDisk:
    return SlowDisk()


def test_change_counts_once_it_is_saved(disk: SlowDisk):
    disk.put("a")
    assert (disk.store.items, disk.answers, disk.num_published) == ({}, [], 0)
    disk.finish()
    assert (list(disk.store.items), disk.answers, disk.num_published) == (["a"], ["a"], 1)


def test_changes_that_wait_for_the_disk_are_saved_together(disk: SlowDisk):
    for name in "abcd":
        disk.put(name)
    disk.delete("b")
    disk.delete("x")
    assert disk.finish() == ["a"]
    assert disk.finish() == ["a", "c", "d"]
    assert disk.waiting == []
    assert disk.answers == ["a", "unknown_name", "b", "c", "d", "b"]


def test_what_could_not_be_saved_does_not_count(disk: SlowDisk):
    disk.put("a")
    disk.finish()
    disk.put("b")
    disk.delete("a")
    disk.finish("The disk is full.")
    disk.finish("The disk is full.")
    assert list(disk.store.items) == ["a"]
    assert disk.answers == ["a", "not_saved", "not_saved"]
    assert disk.num_published == 1
