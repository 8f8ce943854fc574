"""Versions of maps: what is replaced is kept, and a cut of the power leaves the old or the new."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, MapError, load_map, save_map
from trolley.messages import Zone
from trolley_mapper.edit import map_versions
from trolley_mapper.edit.map_versions import MAX_KEPT, Change, MapVersions

pytestmark = pytest.mark.drives

ZONE = Zone(name="rug", kind="keepout", points=[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here is about the disk itself, which takes its time."""
    monkeypatch.setattr("os.fsync", lambda _: None)


def grid(number: int, name: str = "flat") -> GridMap:
    """A map that can be told from the others by its size, its place and a cell."""
    cells = np.zeros((4, 5 + number), np.int8)
    cells[0, number] = 100
    return GridMap(name, 0.05, Pose2D(float(number), 0.0, 0.0), cells)


def is_version(found: GridMap, number: int) -> bool:
    wanted = grid(number)
    return found.origin == wanted.origin and np.array_equal(found.cells, wanted.cells)


def test_a_first_version_is_a_plain_map(tmp_path: Path) -> None:
    store = MapVersions(tmp_path / "maps")
    assert store.newest("flat") is None
    version = store.save(grid(1), Change(what="mapped"), seeds=[ZONE])
    assert (version.number, version.before) == (1, None)
    assert sorted(file.name for file in (tmp_path / "maps").iterdir()) == [
        "flat.pgm",
        "flat.yaml",
        "flat.zones.toml",
    ]
    assert is_version(load_map(store.file_of("flat")), 1)
    with pytest.raises(LookupError):
        store.take_back("flat")


def test_what_is_replaced_is_kept_and_taken_back_step_by_step(tmp_path: Path) -> None:
    store = MapVersions(tmp_path)
    for number in (1, 2, 3):
        turned = Change(what=f"step {number}", old_T_new=Pose2D(0.0, 0.0, 0.1 * number))
        store.save(grid(number), turned, [ZONE])
    assert store.kept("flat") == [1, 2]
    assert is_version(store.load_kept("flat", 1), 1)
    assert (tmp_path / "versions/flat/0001.zones.toml").read_text().count("rug") == 1
    for wanted, before in ((2, 1), (1, None)):
        version = store.take_back("flat")
        assert is_version(load_map(store.file_of("flat")), wanted)
        assert version.before == before
        assert version.before_T_this.yaw == pytest.approx(0.1 * wanted)
    with pytest.raises(LookupError):
        store.take_back("flat")
    # Nothing was lost on the way back, and each image that lies about belongs to a version.
    assert store.kept("flat") == [1, 2, 3, 4]
    assert [file.name for file in tmp_path.glob("*.pgm")] == ["flat@5.pgm"]


def test_a_map_of_somebody_else_is_kept_with_its_image(tmp_path: Path) -> None:
    save_map(grid(1), tmp_path / "flat.yaml")
    (tmp_path / "flat.yaml").write_text((tmp_path / "flat.yaml").read_text() + "author: Ada\n")
    store = MapVersions(tmp_path)
    store.save(grid(2), Change(what="erased"))
    assert is_version(load_map(store.file_of("flat")), 2)
    assert is_version(store.load_kept("flat", 1), 1)
    assert (tmp_path / "flat.pgm").exists()  # another YAML file may name it
    store.take_back("flat")
    assert is_version(load_map(store.file_of("flat")), 1)


def test_the_oldest_versions_are_dropped(tmp_path: Path) -> None:
    store = MapVersions(tmp_path)
    for number in range(1, MAX_KEPT + 6):
        store.save(grid(number), Change(what="again"))
    assert store.kept("flat") == list(range(5, MAX_KEPT + 5))
    assert len(list((tmp_path / "versions/flat").iterdir())) == 3 * MAX_KEPT
    store.save(grid(1, "other"), Change(what="mapped"))
    assert store.kept("other") == []


class Cut(BaseException):
    """The power is cut."""


@pytest.mark.parametrize("is_done", [True, False])
@pytest.mark.parametrize("act", ["save", "take_back"])
def test_a_cut_at_any_write_leaves_the_old_map_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str, *, is_done: bool
) -> None:
    write, unlink = map_versions.write_atomically, Path.unlink
    left = [0]

    def counted(do: Callable[..., None]) -> Callable[..., None]:
        def call(*args: Any, **options: Any) -> None:
            left[0] -= 1
            is_last = left[0] == 0
            if is_last and not is_done:
                raise Cut
            do(*args, **options)
            if is_last:
                raise Cut

        return call

    for cut in range(1, 30):
        folder = tmp_path / str(cut)
        store = MapVersions(folder)
        store.save(grid(1), Change(what="mapped"), seeds=[])
        store.save(grid(2), Change(what="erased"))
        with monkeypatch.context() as patch:
            patch.setattr(map_versions, "write_atomically", counted(write))
            patch.setattr(Path, "unlink", counted(unlink))
            left[0] = cut
            try:
                if act == "save":
                    store.save(grid(3), Change(what="turned"), [ZONE], [ZONE])
                else:
                    store.take_back("flat", [ZONE], [ZONE])
            except Cut:
                pass
            else:
                break
        found = load_map(store.file_of("flat"))
        assert is_version(found, 2) or is_version(found, 3 if act == "save" else 1), cut
        for number in store.kept("flat"):
            assert is_version(store.load_kept("flat", number), number), cut
        store.save(grid(4), Change(what="once more"))  # and it goes on
        assert is_version(load_map(store.file_of("flat")), 4)
        assert len(list(folder.glob("flat@*"))) == 1
        store.take_back("flat")
    assert cut > 5  # it came to its end


def test_a_full_disk_changes_nothing_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = MapVersions(tmp_path)
    store.save(grid(1), Change(what="mapped"))
    before = {file.name: file.read_bytes() for file in tmp_path.glob("flat*")}

    def full(path: Path, content: bytes, mode: int = 0) -> None:
        if path.suffix == ".yaml" and path.parent == tmp_path:
            raise OSError(28, "No space left on device")
        path.write_bytes(content)

    monkeypatch.setattr(map_versions, "write_atomically", full)
    with pytest.raises(MapError, match=r"No space left on device.*make room"):
        store.save(grid(2), Change(what="erased"))
    assert {file.name: file.read_bytes() for file in tmp_path.glob("flat*")} == before
